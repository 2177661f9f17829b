"""A page for who stands beside a cell whose robots drivers move: what goes on there, and buttons.

Imports live, follow, operate, engine, recorders and run; api imports it.
"""
