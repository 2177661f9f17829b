"""Replications of a study: design, executors, results and statistics.

Imports engine, run and scenario; the rest of study imports it.
"""
