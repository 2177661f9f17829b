"""Robots that share one description: which links each of them moves, and the links that none of them moves."""
