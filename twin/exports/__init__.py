"""Runs in the formats of other programs.

Imports run; commands import it.
"""
