"""Replications of a study: design, execution, results and statistics."""
