"""Collision checks: capsules propose, convex hulls decide, what is undecided is halved.

Imports cell and kinematics; everything that plans or checks motion imports it.
"""
