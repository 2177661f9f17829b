"""Distributions that fit measured durations best.

Imports durations; commands import it.
"""
