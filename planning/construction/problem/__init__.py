"""Construction problems as data: models, parts, supplies, contacts, reach, precedence, settings.

Imports cell, geometry and parts; every other room of construction imports it.
"""
