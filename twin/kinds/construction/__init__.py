"""Constructions of parts placed by mobile robots, with space-time planning."""
