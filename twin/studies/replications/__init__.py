"""Replications of a study: design, executors, results and statistics.

Imports engine, operate, run, scenario and the names of audit engines; the rest of study imports it.
"""
