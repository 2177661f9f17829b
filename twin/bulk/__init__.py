"""Bulk engine: simulation of many replications in parallel, by longest paths instead of events.

Imports the execution model and uncertainty; studies and forecasts import it.
"""
