"""What robots, parts and fixtures look like, for whoever shows them: triangles and colours.

Imports planning; recorders and exports import it.
"""
