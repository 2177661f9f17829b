"""Disturbances, named random draws, and the node times they give in a replication.

Imports durations; engine, run and scenario import it.
"""
