"""Construction problems as data: models, parts, supplies, contacts, reach and precedence.

Imports cell, geometry and parts; every other room of construction imports it.
"""
