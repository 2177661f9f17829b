"""Shortcuts on a temporal plan graph (APEX-MR IV-C).

Imports graph, conflicts and invariant.
"""
