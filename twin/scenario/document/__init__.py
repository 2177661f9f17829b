"""YAML documents with a place for every value, and problems as people read them.

Imports planning.errors only.
"""
