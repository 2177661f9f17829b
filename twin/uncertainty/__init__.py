"""Disturbances, named random draws, and the node times they give in a replication.

Imports durations and the base of scenario sections; engine, runs and scenario import it.
"""
