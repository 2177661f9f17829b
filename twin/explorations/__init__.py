"""Search for better cell designs: design variables, evaluation in steps of increasing cost, and comparison.

Imports studies for plans and replications, and is imported by no other package.
"""
