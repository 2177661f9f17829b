"""Sequences of steps that build a structure: assembly by disassembly (APEX-MR App. A).

Imports bricks, stability, skills and insertion.
"""
