"""Fits of distributions to measured durations, ranked and tested.

Imports durations; commands import it.
"""
