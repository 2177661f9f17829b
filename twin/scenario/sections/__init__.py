"""The sections of a scenario file as pydantic models.

Imports document; assemblies and scenario import it.
"""
