"""Construction by mobile teams (Hartmann et al.): the search over parts, robots and times.

Rooms below, from data to results: problem, world, checks, paths.
"""
