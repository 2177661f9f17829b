"""The commands of the ``twin`` program, one a file.

The modules import nothing heavy: what a command needs is imported when it runs.
"""
