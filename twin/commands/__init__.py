"""The program: command.py makes a command of a function; a file has the commands of one subject.

Everything heavy is imported inside the functions. Imports any room of twin; only cli.py imports it.
"""
