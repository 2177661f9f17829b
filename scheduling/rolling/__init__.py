"""Rolling graph: a plan cut during its execution, and extended from the world at the cut."""
