"""Assemblies of parts: robots place parts of any shape and apply processes to them.

Imports skills, contacts and statics, and what those import.
"""
