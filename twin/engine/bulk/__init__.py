"""Bulk engine: many replications side by side, as longest paths.

Imports engine.execution_model, runs and uncertainty; studies imports it.
"""
