"""Monitoring of a running cell: its state from logged events, and a forecast of the end of the run.

Imports engine, recorders, runs, scenario and trial; commands import it.
"""
