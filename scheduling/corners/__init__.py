"""Rounding of the corners of transits, so that robots pass them at speed.

Imports conflicts, graph and shortcuts; the core calls it through the registry.
"""
