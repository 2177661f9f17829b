"""Bulk engine: many replications side by side, as longest paths.

Imports engine.messages, run and uncertainty; study imports it.
"""
