"""Appearance of robots, parts and fixtures: triangles and colours.

Imports planning; recorders and exports import it.
"""
