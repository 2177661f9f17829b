"""Readers of files that others publish; each makes a scenario of them.

May import lego; nothing in planning imports it.
"""
