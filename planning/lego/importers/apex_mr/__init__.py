"""Reader of the task files of the APEX-MR authors.

Imports planning's own files only; nothing in planning imports it.
"""
