"""Collision checks of robots that move in space and time, in compiled code.

Imports world, geometry, steps and motion; paths, keyframes and export import it.
"""
