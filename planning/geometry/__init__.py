"""Compiled kinematics and collision geometry."""
