"""Scenario files: from YAML to checked sections, and from those to manifests and variations.

Imports its rooms (document, sections), planning, durations and uncertainty.
"""
