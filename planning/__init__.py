"""From a cell and an assembly to a motion plan: who does what, and how everyone moves."""
