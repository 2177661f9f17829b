"""Exports of runs to the formats of other programs.

Imports runs, host and, of scenario, the manifest; commands import it.
"""
