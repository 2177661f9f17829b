"""Runs in the formats of other programs.

Imports run, and of scenario the manifest; commands import it.
"""
