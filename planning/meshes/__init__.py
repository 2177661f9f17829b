"""Meshes of parts and fixtures: read from files, and cut into convex pieces.

Imports cell only; trimesh and coacd are slow to import, so only when a mesh is read.
"""
