"""Orders of tasks: which robot goes first where two would meet.

Imports graph, conflicts and build_tpg.
"""
