"""An independent check of a finished construction, from its timelines alone.

Imports planning and the geometry of scheduling.witness; shares no checks with the planner.
"""
