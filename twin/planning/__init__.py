"""Planning of scenarios: kinds of assemblies, the cell, and the pipeline to the temporal plan graph.

Imports scenario.sections, document, host, scheduling and planning; scenario asks it for checks.
"""
