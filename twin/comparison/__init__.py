"""One plan under every policy, compared as in the APEX-MR paper.

Imports planning, assemblies, run and trial; commands import it.
"""
