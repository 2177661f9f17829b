"""A cell that is running: its state from its events, and a forecast of the rest.

Imports run, trial and uncertainty; commands import it.
"""
