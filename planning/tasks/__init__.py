"""Tasks and steps as data, and their assignment to robots by an integer program.

Imports cell only; motion, steps and all kinds of assemblies import it.
"""
