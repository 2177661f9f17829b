"""Assemblies of parts: parts of any shape put in their places by robots, and processes done to them.

Imports skills, contacts and statics, and what those import.
"""
