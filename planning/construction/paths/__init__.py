"""Paths through space and time: straight ways, roadmaps, the space-time RRT, retiming (IV-C).

Imports checks; the search imports it.
"""
