"""Collision checks of robots that move in space and time, compiled.

Imports world, geometry, steps and motion; paths, keyframes and export import it.
"""
