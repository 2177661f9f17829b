"""Grips on parts: rules, boxes, other shapes, and the capabilities of the tools of a cell.

Imports cell, geometry and steps; assemblies of parts import it.
"""
