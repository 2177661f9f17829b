"""A web page for people next to a cell with drivers: progress of the run, and buttons.

Imports live, follow, operations, engine, recorders and runs; api imports it.
"""
