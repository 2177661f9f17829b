"""Grips on parts: rules, boxes, other shapes, and the capabilities of the tools of a cell.

Imports cell, geometry, statics and steps; parts and constructions import it.
"""
