"""Task order: which robot goes first where two conflict.

Imports graph, conflicts, build_nodes and build_tpg.
"""
