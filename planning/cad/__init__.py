"""Assemblies from CAD files: bodies of STEP files, bodies that are alike, and where they lie at the start.

The CAD kernel runs in a process of its own, within limits, as it may crash on files that are not valid.
"""
