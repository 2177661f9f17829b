"""Forward and inverse kinematics of placed robots, in compiled code.

Imports cell only.
"""
