"""Feasibility of pressing a brick on: force, room for the tools, supports.

Imports bricks, skills and stability; sequencing imports it.
"""
