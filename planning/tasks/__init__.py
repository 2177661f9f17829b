"""Who does what: assignment problem and integer program, tasks, task plan.

Imports cell only; motion, skills and all kinds of assemblies import it.
"""
