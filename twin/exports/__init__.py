"""Export of runs to the file formats of other programs.

Imports runs, host and, of scenario, the manifest; commands import it.
"""
