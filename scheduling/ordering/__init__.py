"""Orders of tasks: which robot goes first where two would meet.

Imports graph, conflicts, build_nodes and build_tpg.
"""
