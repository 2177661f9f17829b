"""What is worth fixing: by how much a study's makespans fall when one thing takes less time.

Imports engine, recorders, runs, uncertainty and studies.replications; the rest of studies imports it.
"""
