"""Construction problems as data: models, parts, supplies, contacts, reach, precedence, settings.

Imports cell, robots, kinematics, geometry, skills and parts; all of construction may import it.
"""
