"""Sensitivity of the makespan to inputs: tornado and Sobol indices.

Imports replications.
"""
