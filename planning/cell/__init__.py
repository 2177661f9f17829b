"""The cell as data: robots, fixtures and objects, convex bodies, robot models.

Imported by every other room; imports none of them.
"""
