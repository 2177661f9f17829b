"""Collision worlds of the audit: a copy of the cell for the library coal, and one in PyBullet for cross-checks.

Imports host, and no other package of twin; audits imports it.
"""
