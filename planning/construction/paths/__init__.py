"""Paths through space and time: direct ones, roadmaps, the space-time RRT, retiming (IV-C).

Imports problem, world and checks; the search imports it.
"""
