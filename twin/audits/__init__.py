"""Audit of a run: a collision engine replays what was executed and measures every distance.

Shares no collision geometry with planning; of twin it imports host only. trial and study import
it, and twin.planning, which says what a scenario wants.
"""
