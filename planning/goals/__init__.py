"""Goals of robots as assembly steps: configurations, and an order in which robots make room for each other.

Imports cell, geometry, motion, steps and tasks.
"""
