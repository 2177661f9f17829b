"""Recorders of a run: events, tables and 3-D recording.

Imports runs; engine and trial import it.
"""
