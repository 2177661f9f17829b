"""Conflicts between nodes of different robots, by what the nodes occupy; ``DerivedTpg`` is asked.

Imports graph and planning's geometry.
"""
