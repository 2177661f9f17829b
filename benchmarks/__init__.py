"""Measurements: ``python -m benchmarks.<name>``. Results are kept in benchmarks/results."""
