"""Distributions fitted to measured durations: candidates, tests of fit, YAML and pictures."""
