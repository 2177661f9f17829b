"""The temporal plan graph: nodes, edges, total order, reduction, rollout, dispatcher, files.

Imports planning; every other room of scheduling imports it.
"""
