"""When a robot is where on a path that it follows within its limits of speed, acceleration and jerk.

Imports planning.cell, planning.kinematics and what every room may import; motion, scheduling and twin import it.
"""
