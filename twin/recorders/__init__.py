"""Observers of a run that write its events, tables and 3-D recording.

Imports runs; engine and trial import it.
"""
