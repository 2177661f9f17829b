"""Robot models: the registry of names, URDF reading, self-collision pairs, tool shapes.

Imports cell, kinematics and geometry.
"""
