"""LEGO assemblies. Rooms from data to plans: bricks, stability, skills, sequencing.

Imports skills and what those import; importers and the twin import it.
"""
