"""Motion between skills: transits, speeds, and sequential plans.

Imports cell, geometry, tasks and timing.
"""
