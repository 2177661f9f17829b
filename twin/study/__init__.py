"""Monte-Carlo studies: plans, replications, summary and report.

Imports its rooms (replications, sensitivity), planning, trial and audit; commands import it.
"""
