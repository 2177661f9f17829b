"""Constructions in the twin: planning what is left when something fails.

Imports planning.construction and operate.
"""
