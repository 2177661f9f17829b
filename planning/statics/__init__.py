"""Static equilibrium of rigid bodies: contacts with friction, joints, and stable build orders.

Independent of bricks and robots; the assembly kinds supply the contacts.
"""
