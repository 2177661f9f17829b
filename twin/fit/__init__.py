"""Fits of distributions to measured durations, ranked and tested.

Imports durations, host and run.folder; commands import it.
"""
