"""Kinds of assemblies, each behind the same few functions.

Imports scenario.sections, scenario.document and planning; scenario and twin.planning import it.
"""
