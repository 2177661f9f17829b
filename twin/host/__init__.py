"""The machine that the program runs on: whole files, pictures, progress, exit codes, kernels.

Imports planning.errors and planning.kernels only; every room of twin may import it.
"""
