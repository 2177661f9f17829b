"""Probability distributions of skill durations: one class each, with scenario section, quantiles and fit.

Imports planning and the base of scenario sections; scenario, uncertainty and fit import it.
"""
