"""Drawing: Gantt charts, the style of pictures, colours of lanes and robots, triangles of shapes.

Imports planning, runs and activities; exports, recordings, studies and checks import it.
"""
