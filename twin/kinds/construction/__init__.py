"""Constructions: parts that mobile robots put in their places, planned in space and time."""
