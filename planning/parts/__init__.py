"""Assemblies of parts: boxes, beams and rods, each put in its place by one robot.

Imports skills and what those import; construction uses its contact graph.
"""
