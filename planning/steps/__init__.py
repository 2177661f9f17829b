"""Expansion of assignment choices to tasks for every kind of assembly: skills, candidates, handovers, tool changes.

Imports cell, geometry, motion and tasks; kinds of assemblies bring grips, seats and allowed contacts.
"""
