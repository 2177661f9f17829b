"""Recorders of a run: they write its events and tables."""
