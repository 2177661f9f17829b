"""Records of a run: events, trajectories, summary, folder.

Imports uncertainty; recorders, engine, exports and trial import it.
"""
