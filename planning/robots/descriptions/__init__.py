"""Robot and tool descriptions (URDF and MJCF): reading, checks, and mounting of tools on arms.

Imports cell and meshes.
"""
