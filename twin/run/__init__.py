"""What happened in a run: events, trajectories, summary, pictures, the folder of it.

Imports uncertainty; recorders, engine, exports and trial import it.
"""
