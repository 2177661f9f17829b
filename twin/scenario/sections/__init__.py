"""The sections of a scenario file as pydantic models.

Imports document, durations and uncertainty; assemblies and scenario import it.
"""
