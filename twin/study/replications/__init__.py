"""Replications of a study: what to run, where, and what is kept of each.

Imports engine and run; the rest of study imports it.
"""
