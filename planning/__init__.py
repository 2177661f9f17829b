"""Who does what and how everyone moves, in planned time. Imports nothing of scheduling or twin.

The files here (errors, transforms, parallel) import nothing of the package; all rooms may import them.
"""
