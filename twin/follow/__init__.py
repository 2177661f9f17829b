"""Following a running cell: its state from its events, and a forecast of the end.

Imports engine, recorders, runs, scenario and trial; commands import it.
"""
