"""Task assignment and motion planning, in planned time. Imports nothing of scheduling or twin.

The files here (errors, transforms, kernels, packed, silence, parallel, files) do not import any subpackage; all
subpackages may import them.
"""
