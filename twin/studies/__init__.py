"""Monte-Carlo studies: plans, replications, summary and report.

Imports its room replications, planning, engine, trial and audit; its report and commands import it.
"""
