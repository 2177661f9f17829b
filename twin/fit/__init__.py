"""Fits of distributions to measured durations, ranked and tested.

Imports durations, host and runs.folder; commands import it.
"""
