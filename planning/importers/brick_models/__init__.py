"""Brick models of other programs: their bricks on the stud grid, and a cell to build them in.

Imports planning's own files only; the readers of brick lists and of LDraw import it.
"""
