"""Synthetic skill timings that ship with the package, and the script that writes them.

Read by twin.durations.
"""
