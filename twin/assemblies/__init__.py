"""Kinds of assemblies: each answers plan(cell, settings, watch) with its motions.

Imports scenario.sections, scenario.document, host and planning; scenario and twin.planning import it.
"""
