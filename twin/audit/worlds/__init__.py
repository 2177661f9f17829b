"""Collision libraries that the audit measures with, behind one interface.

Of twin it imports host only; audit imports it.
"""
