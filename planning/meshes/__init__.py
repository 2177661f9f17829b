"""Meshes of parts and fixtures: read from files, and cut into convex pieces.

Imports planning.cell and what is beside it only. trimesh and coacd are slow to import: they are
when a mesh is read.
"""
