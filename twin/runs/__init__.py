"""Records of a run: events, trajectories, summary, pictures, folder.

Imports uncertainty; recorders, engine, exports and trial import it.
"""
