"""Brick models of other programs: readers of brick lists and of LDraw, and a cell to build them in.

Imports planning's own files only; nothing in planning imports it.
"""
