"""Exports of runs to the formats of other programs.

Imports run, host and, of scenario, the manifest; commands import it.
"""
