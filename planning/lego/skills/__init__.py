"""The six LEGO skills: poses, joint paths, supports, handovers, candidates for the assignment.

Imports bricks; sequencing imports it.
"""
