"""Motion between skills: transits, speeds, sequential plans, robots that move as one.

Imports cell, geometry and tasks.
"""
