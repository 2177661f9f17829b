"""Lines: sources and products of a scenario, written out as parts, steps, supplies and a pattern.

Imports scenario.sections; the other rooms of twin.planning import it.
"""
