"""Audit of a run: a collision engine replays the execution and measures every distance.

Shares no collision geometry with planning; of twin it imports host only. trial and studies import it,
and twin.planning, which gives the expectations of a scenario.
"""
