"""The six LEGO skills: poses, joint paths, supports, handovers, candidates for the assignment.

Imports bricks, steps, tasks and kinematics; insertion and sequencing import it.
"""
