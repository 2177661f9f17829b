"""Motion of a run as it was recorded: sampled, bounded between samples, and pairs that may meet.

Imports the worlds of the audit.
"""
