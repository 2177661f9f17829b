"""One trial of a plan: execute, record, audit, resume.

Imports engine, recorders, runs, planning and scenario.
"""
