"""Static equilibrium of rigid bodies: contacts with friction, joints, and what stands when.

Free of bricks and robots; the rooms of the assembly kinds say what touches what.
"""
