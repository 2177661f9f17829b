"""What is worth fixing: by how much a study's makespans fall when one thing takes less time.

Imports engine, recorders, run, uncertainty and study.replications; the rest of study imports it.
"""
