"""A cell that is running: its state from its events, and a forecast of the rest.

Imports engine, recorders, run and trial; commands import it.
"""
