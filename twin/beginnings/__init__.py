"""Beginnings of new scenarios: ``twin init``.

Imports scenario; explorations import it.
"""
