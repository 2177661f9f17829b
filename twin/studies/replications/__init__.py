"""Replications of a study: design, executors, results and statistics.

Imports engine, operations, runs, scenario and the names of audit engines; the rest of studies imports
it.
"""
