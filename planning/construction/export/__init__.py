"""Export of a space-time plan: tasks, and the motion plan that everything else takes.

Imports problem, world, checks, motion and tasks; the twin imports it.
"""
