"""Whether a brick can be pressed on: the force that takes, room for the tools, where to hold.

Imports bricks, skills and stability; sequencing imports it.
"""
