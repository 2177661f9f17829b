"""Monte-Carlo studies: plans, replications, summary and report."""
