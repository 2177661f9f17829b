"""Construction problems as data: models, parts, supplies, contacts, reach, precedence, settings.

Imports cell, robots, kinematics, geometry and parts; all of construction may import it.
"""
