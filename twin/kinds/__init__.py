"""Kinds of assembly, each with a scenario section, planning, checks and pictures.

Data and methods that do not depend on scenarios are in the folder of the same name in ``planning``.
"""
