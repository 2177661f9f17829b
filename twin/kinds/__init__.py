"""Kinds of assembly: scenario section, planning, checks and pictures of each.

Data and methods of a kind, which know no scenarios, are in the folder of the same name in ``planning``.
"""
