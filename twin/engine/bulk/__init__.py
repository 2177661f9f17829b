"""Bulk engine: many replications side by side, as longest paths.

Imports engine.execution_model, run and uncertainty; study imports it.
"""
