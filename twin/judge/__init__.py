"""Audit of plans from other planners, at planned times and under random delays."""
