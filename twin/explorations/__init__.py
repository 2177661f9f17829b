"""Exploration of cell designs: dimensions, evaluation in rungs, the best designs and their gains.

Imports studies for plans and replications, and is imported by no other room.
"""
