"""The world as planned so far: timelines of robots and objects, and what they sweep.

Imports problem and geometry; checks, paths, keyframes and export import it.
"""
