"""Kinds of assembly: of each the section of a scenario, how it is planned, and what is checked and drawn of it.

Data and methods of a kind, which know no scenarios, are in the folder of the same name in ``planning``.
"""
