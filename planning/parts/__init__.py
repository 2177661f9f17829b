"""Assemblies of parts: robots place parts of any shape and apply processes to them.

Imports steps, contacts, grips and statics, and what those import.
"""
