"""Fits of distributions to measured durations, with goodness-of-fit tests and ranking.

Imports durations, host and runs.folder; commands import it.
"""
