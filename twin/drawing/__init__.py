"""Drawing: Gantt charts, picture style, colours of activities and robots, and triangles of shapes.

Imports planning, runs and activities; exports, recordings, studies and checks import it.
"""
