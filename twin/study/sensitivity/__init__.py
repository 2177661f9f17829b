"""Which inputs the makespan depends on: tornado and Sobol indices.

Imports replications.
"""
