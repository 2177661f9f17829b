"""Collision checks of robots that move in space and time, compiled.

Imports world and geometry; paths, keyframes and export import it.
"""
