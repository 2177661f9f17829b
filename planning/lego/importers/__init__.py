"""Importers of task files that others publish, one room a format.

Imports planning's own files only; nothing in planning imports it.
"""
