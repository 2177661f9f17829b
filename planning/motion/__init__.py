"""Motion between skills: transits, speeds, sequential plans, and composite motions of several robots.

Imports cell, geometry, tasks and timing.
"""
