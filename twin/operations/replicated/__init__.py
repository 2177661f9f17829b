"""Operated replications of a study, and the plans with hindsight that they are compared with.

Imports operate, planning and engine; study imports it.
"""
