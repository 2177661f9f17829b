"""One plan under every policy, compared as in the APEX-MR paper.

Imports planning, run and trial; commands import it.
"""
