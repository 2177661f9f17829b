"""Motion between skills: transits, speeds, sequential and synchronous plans.

Imports cell, geometry and tasks.
"""
