"""Task assignment and motion planning, in planned time. Imports nothing of scheduling or twin.

The files here (errors, transforms, kernels, packed, silence, parallel, files) import no room; all
rooms may import them.
"""
