"""The program, a file a command (run and resume share one).

Everything heavy is imported inside the functions. Imports any room of twin; only cli.py imports it.
"""
