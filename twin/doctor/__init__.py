"""Check of the installation by ``twin doctor``.

Imports host and the registry; nothing imports it.
"""
