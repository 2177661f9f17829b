"""An independent check of a finished construction, from its timelines alone.

Imports planning and the reference geometry of scheduling.verification; shares no checks with the planner.
"""
