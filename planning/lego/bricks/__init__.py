"""Bricks, plates and structures as data on the stud grid, and where bricks touch.

Imports cell; the other subpackages of lego import it.
"""
