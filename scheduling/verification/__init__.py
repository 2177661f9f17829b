"""Independent verification of a saved plan, with other code and geometry (`twin verify`).

Imports graph and planning's data; nothing of conflicts.
"""
