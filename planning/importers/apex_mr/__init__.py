"""Reader of the task files of the APEX-MR authors.

May import lego; nothing in planning imports it.
"""
