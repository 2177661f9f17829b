"""Robot models: registry of robot types, URDF import, self-collision pairs and tool shapes.

Imports cell, kinematics and geometry.
"""
