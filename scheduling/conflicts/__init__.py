"""Conflicts between nodes of different robots, by their swept volumes; ``DerivedTpg`` is the entry point.

Imports graph and planning's geometry.
"""
