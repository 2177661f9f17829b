"""Task order: which robot goes first where two conflict, and the synchronous baseline.

Imports graph, conflicts, build_nodes and build_tpg.
"""
