"""LEGO assemblies. Rooms from data to plans: bricks, stability, skills, sequencing.

Imports skills and what those import; the twin imports it.
"""
