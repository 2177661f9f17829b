"""Exploring designs of a cell: which keys vary, how far each design gets, what is best, and what it is worth.

Imports studies for plans and replications, and is imported by no other room.
"""
