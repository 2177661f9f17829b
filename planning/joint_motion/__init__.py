"""Collision checks of several bodies that move at the same time.

Imports geometry.
"""
