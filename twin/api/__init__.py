"""Functions for scripts that plan, simulate and run one scenario; those of optional parts are in their ``api.py``.

Imported by twin/__init__ when a name is first used, and by the commands.
"""
