"""Scenario files: from YAML to checked sections, and from those to manifests and variations.

Imports document, its room sections, planning, durations and uncertainty.
"""
