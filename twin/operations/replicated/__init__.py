"""Operated replications of a study, and the plans with hindsight that they are compared with.

Imports operations, planning and engine; studies imports it.
"""
