"""From a space-time plan to tasks and the motion plan that everything else takes.

Imports problem, world and checks.
"""
