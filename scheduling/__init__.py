"""From a motion plan to a temporal plan graph, and proofs of its guarantee; no clock.

Imports planning; the twin imports it.
"""
