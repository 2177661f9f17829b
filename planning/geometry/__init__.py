"""Collision checks: capsules as broad phase, convex hulls as narrow phase, bisection of what is undecided.

Imports cell and kinematics; everything that plans or checks motion imports it.
"""
