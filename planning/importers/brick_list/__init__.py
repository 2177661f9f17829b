"""Reader of brick lists, one brick a line, as BrickGPT writes them.

Imports planning's own files and the models of bricks; nothing in planning imports it.
"""
