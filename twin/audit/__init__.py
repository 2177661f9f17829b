"""The independent witness: PyBullet replays what a run executed and measures every distance.

Shares no geometry with planning; trial and study import it.
"""
