"""Distributions of skill durations: one class each, with its section, quantiles and fit.

Imports planning and the base of scenario sections; scenario, uncertainty and fit import it.
"""
