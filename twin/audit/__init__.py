"""The independent witness: PyBullet replays what a run executed and measures every distance.

Shares no geometry with planning; imports host only. trial and study import it.
"""
