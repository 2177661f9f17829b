"""Assemblies of parts: parts that are put in their places, and processes, machines and lines."""
