"""Importers of published task files, one folder per format.

Imports bricks and skills; nothing in planning imports it.
"""
