"""Replanning during an assembly: the current state of the cell, and plans of the remaining steps."""
