"""Forward and inverse kinematics of placed robots, compiled.

Imports cell only.
"""
