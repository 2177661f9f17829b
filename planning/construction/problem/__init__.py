"""Construction problems as data: models, parts, supplies, contacts, reach, precedence, settings.

Imports cell, contacts, geometry, grips, kinematics, statics, steps and tasks; all of construction may import it.
"""
