"""A check of finished plans that shares nothing with the planner."""
