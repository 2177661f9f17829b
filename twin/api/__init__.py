"""The way in from Python: a function a step, and what each returns.

Imported by twin/__init__ when a name is first used, and by the commands; imports every room below.
"""
