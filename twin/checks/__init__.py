"""Checks of a scenario before planning: errors, warnings, and a picture.

Imported by the commands; imports the kinds of assemblies and the geometry of planning.
"""
