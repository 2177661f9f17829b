"""Warnings about what a plan cannot keep to when it is executed.

Imports engine and uncertainty; studies import it.
"""
