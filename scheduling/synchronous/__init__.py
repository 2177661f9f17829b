"""Synchronous baseline: plans in slots, in which robots wait for each other, and joint motions of several robots.

Imports conflicts, graph and ordering; the core calls it through the registry.
"""
