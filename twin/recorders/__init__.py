"""Recorders of a run: events and tables.

Imports runs; engine and trial import it.
"""
