"""Checks of a scenario before planning, with errors, warnings and a picture of the cell.

Imported by the commands; imports the kinds of assemblies and the geometry of planning.
"""
