"""Basic commands of the ``twin`` program, one file per subject, with shared options and output.

Large packages are imported inside the functions. twin/cli.py finds commands in the registry.
"""
