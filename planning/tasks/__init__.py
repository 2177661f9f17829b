"""Task assignment: problem, integer program, task plan; tasks and their steps as data.

Imports cell only; motion, steps and all kinds of assemblies import it.
"""
