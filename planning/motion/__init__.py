"""How robots move between skills: transits, speeds, sequential and synchronous plans.

Imports cell, kinematics, geometry and tasks.
"""
