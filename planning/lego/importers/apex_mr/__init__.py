"""Reader of the task files of the APEX-MR authors.

Imports bricks; nothing in planning imports it.
"""
