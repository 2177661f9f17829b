"""YAML documents with positions of values, readable problems, and the base class of sections.

Imports planning.errors only.
"""
