"""Keyframes: configurations at the mode switches of one part (Hartmann et al. IV-B).

Imports problem, world and checks.
"""
