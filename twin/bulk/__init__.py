"""Bulk engine: many replications side by side, as longest paths.

Imports the execution model and uncertainty; studies and forecasts import it.
"""
