"""Following a running cell: its state from its events, and a forecast of the end.

Imports engine, recorders, run, scenario and trial; commands import it.
"""
