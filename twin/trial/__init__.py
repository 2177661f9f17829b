"""Runs of a plan: planning, execution, recording, audit and resumption."""
