"""Search among assignments by a predicted makespan.

The integer program minimizes a sum of distances from HOME; the search also predicts the waits and travel of robots.
"""
