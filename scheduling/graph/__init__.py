"""The temporal plan graph: nodes, edges, total order, reduction, rollout, dispatcher, files.

Imports planning's cell, robots and tasks; every other room of scheduling imports it.
"""
