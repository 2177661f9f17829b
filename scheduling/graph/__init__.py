"""The temporal plan graph: nodes, edges, total order, reduction, rollout, dispatcher, files.

Imports planning's cell, robots and tasks; every other subpackage of scheduling imports it.
"""
