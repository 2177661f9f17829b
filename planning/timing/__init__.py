"""Time parameterization of paths within limits of speed, acceleration, jerk and effort.

Imports planning.cell, planning.kinematics and general modules; motion, scheduling and twin import it.
"""
