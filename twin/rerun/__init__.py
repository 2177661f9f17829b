"""3-D recordings of runs for the Rerun viewer."""
