"""The cell as data: robots, fixtures and objects, convex bodies, robot models.

Imported by every other subpackage of planning; imports none of them.
"""
