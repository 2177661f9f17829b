"""Robot models: the registry of names, URDF reading, meshes and URDFs of our own.

Imports cell, kinematics and geometry.
"""
