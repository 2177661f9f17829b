"""A second proof of a saved plan, with other code and other geometry (`twin verify`).

Imports graph and planning's data; nothing of conflicts.
"""
