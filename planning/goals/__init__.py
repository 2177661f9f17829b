"""Assemblies of kind goals: robots go from goal to goal and handle nothing.

Imports skills and what those import; the twin imports it.
"""
