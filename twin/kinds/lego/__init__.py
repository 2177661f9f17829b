"""Commands for LEGO assemblies: sequencing, and scenarios from files of other programs.

Imports planning.lego and planning.importers; nothing imports it.
"""
