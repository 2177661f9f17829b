"""The world as planned so far: timelines of robots and objects, tasks, and swept volumes.

Imports problem, geometry, steps and tasks; checks, paths, keyframes and export import it.
"""
