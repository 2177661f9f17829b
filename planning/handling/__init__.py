"""Skills that handle objects: paths and collision checks, handovers, placements, and tool changes at racks.

Imports cell, contacts, geometry, steps and tasks; the kinds of assembly in which objects are handled import it.
"""
