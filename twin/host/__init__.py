"""Interface to the computer: atomic files, notebook cards, progress displays, exit codes, package versions.

Imports planning.errors and planning.kernels only; every package of twin may import it.
"""
