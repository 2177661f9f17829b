"""Static equilibrium of rigid bodies: contacts with friction, joints, and stable build orders.

Free of bricks and robots; the rooms of the assembly kinds say what touches what.
"""
