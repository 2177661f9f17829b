"""The cell in which the audit measures, with coal, and the same in PyBullet for a second look.

Of twin it imports host only; audit imports it.
"""
