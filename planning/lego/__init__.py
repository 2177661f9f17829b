"""LEGO assemblies. Rooms from data to plans: bricks, stability, skills, sequencing.

Imports cell, steps, tasks, statics and what those import; the twin imports it.
"""
