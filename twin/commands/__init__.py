"""Commands of the core, one file per subject, and shared options and views.

Everything heavy is imported inside the functions. twin/cli.py finds commands in the registry.
"""
