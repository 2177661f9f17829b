"""YAML documents with the position of each value, clear error messages, and the base class of scenario sections.

Imports planning.errors only.
"""
