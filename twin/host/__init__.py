"""The machine that the program runs on: whole files, progress, exit codes, compiled kernels.

Imports planning.errors only; every room of twin may import it.
"""
