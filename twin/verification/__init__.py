"""Verification of saved plans, for the program: ``twin verify``.

Imports scheduling.verification; nothing imports it.
"""
