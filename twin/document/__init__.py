"""YAML documents with a place for every value, problems as people read them, the base of sections.

Imports planning.errors only.
"""
