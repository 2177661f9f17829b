"""Brick models of other programs: readers of brick lists and of LDraw, and a cell to build them in.

Imports bricks, skills, steps and robots; nothing in planning imports it.
"""
