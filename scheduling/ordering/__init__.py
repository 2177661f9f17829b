"""Task order: which robot goes first where two conflict, better plans, and the synchronous baseline.

Imports graph, conflicts, shortcuts and build_tpg.
"""
