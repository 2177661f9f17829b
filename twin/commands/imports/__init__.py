"""``twin import``, a file a kind of file that others write.

Everything heavy is imported inside the functions. Imports any room of twin; only cli.py imports it.
"""
