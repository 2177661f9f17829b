"""Scenario files: from YAML to checked sections, and from those to cells, models, manifests.

Imports its rooms (document, sections), assemblies, durations and uncertainty.
"""
