"""Static equilibrium of brick structures as a linear program (StableLego).

Imports bricks; sequencing imports it.
"""
