"""Recorded motion of a run: samples, bounds between samples, and pairs that may meet.

Imports the worlds of the audit.
"""
