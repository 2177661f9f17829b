"""The sections of a scenario file as pydantic models.

Imports document, durations and uncertainty; planning and scenario import it.
"""
