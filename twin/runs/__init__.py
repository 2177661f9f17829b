"""Records of a run: events, trajectories, summary and run folder."""
