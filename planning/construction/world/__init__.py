"""The world as planned so far: timelines of robots and objects, tasks, and swept volumes.

Imports problem, geometry, skills and tasks; checks, paths, keyframes and export import it.
"""
