"""Kinds of assemblies, from section to motions: each answers plan(cell, settings, watch).

Imports scenario.sections, scenario.document, host and planning; scenario and twin.planning import it.
"""
