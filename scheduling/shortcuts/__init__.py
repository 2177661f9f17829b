"""Shortcuts on a temporal plan graph (APEX-MR IV-C).

Imports graph, conflicts, invariant and planning's geometry and motion.
"""
