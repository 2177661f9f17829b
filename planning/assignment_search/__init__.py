"""Search among assignments by a predicted makespan.

The integer program adds up distances from HOME; the search knows when robots wait and how far they go.
"""
