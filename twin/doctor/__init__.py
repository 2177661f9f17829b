"""Check of the installation: ``twin doctor``.

Imports host and the registry; nothing imports it.
"""
