"""Export of a space-time plan: tasks, and the motion plan that everything else takes.

Imports problem, world and checks.
"""
