"""The program, one file a command; everything heavy is imported inside the functions.

Imports any room of twin; only cli.py imports it.
"""
