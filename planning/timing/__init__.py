"""Time parametrisation of paths within limits of speed, acceleration and jerk.

Imports planning.cell, planning.kinematics and what every room may import; motion, scheduling and twin import it.
"""
