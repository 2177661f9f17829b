"""Importers of published task files, one folder per format.

Imports planning's own files only; nothing in planning imports it.
"""
