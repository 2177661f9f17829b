"""Search for a better plan: who does what with what, judged by the graph that comes of it.

Imports ordering, conflicts and graph, and planning's tasks and motion.
"""
