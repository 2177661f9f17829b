"""Replanning from the middle of an assembly: the current world, and the remaining work."""
