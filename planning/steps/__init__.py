"""Expansion of assignment choices to tasks for every kind of assembly: skills, candidates, handovers, tool changes.

Imports cell, geometry, motion and tasks; the assembly kinds supply grips, places and allowed contacts.
"""
