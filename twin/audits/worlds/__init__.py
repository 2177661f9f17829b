"""Collision worlds of the audit: a copy of the cell for the library coal, and one in PyBullet for cross-checks.

Of twin, this package imports host only. The package audits imports it.
"""
