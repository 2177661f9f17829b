"""Interface to the machine: atomic files, cards, progress, exit codes, kernels.

Imports planning.errors and planning.kernels only; every room of twin may import it.
"""
