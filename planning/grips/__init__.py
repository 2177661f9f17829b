"""Grips on parts: the rules for them, boxes, other shapes, and what the tools of a cell can hold.

Imports cell, geometry and steps; assemblies of parts import it.
"""
