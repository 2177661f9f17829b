"""Static equilibrium of brick structures as a linear program (StableLego).

Imports bricks and statics; insertion and sequencing import it.
"""
