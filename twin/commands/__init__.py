"""Commands of the core, a file a subject, and what commands of all parts share: options and views.

Everything heavy is imported inside the functions. twin/cli.py finds commands in the registry.
"""
