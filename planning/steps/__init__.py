"""Expansion of assignment choices to tasks: paths of skills, candidates, the tasks of a step, goals of robots.

Imports cell, geometry, motion and tasks; the assembly kinds supply skills, places and allowed contacts.
"""
