"""Gains: reduction of a study's makespans by interventions that shorten parts of a plan.

Imports engine, recorders, runs, uncertainty and studies.replications; the rest of studies imports it.
"""
