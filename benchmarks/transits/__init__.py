"""Transit planning among random boxes, beside another planner."""
