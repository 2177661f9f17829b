"""Feasibility of pressing a brick on: force, room for the tools, supports.

Imports bricks, skills, stability, statics and steps; sequencing imports it.
"""
