"""Assemblies of parts, with processes, machines and production lines."""
