"""Assemblies of parts: robots place parts of any shape and apply processes to them.

Imports steps, contacts, grips, statics and their dependencies.
"""
