"""One trial of a plan: execute it, keep what happened, let the audit judge; resume it.

Imports engine, recorders, run, audit and scenario.
"""
