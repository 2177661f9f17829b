"""Conflicts between nodes of different robots, by what the nodes occupy.

Imports graph and planning's geometry.
"""
