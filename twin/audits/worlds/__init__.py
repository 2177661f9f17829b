"""The audit's copy of the cell, with coal, and a second one in PyBullet for cross-checks.

Of twin it imports host only; audits imports it.
"""
