"""What happened in a run: as data, as files, as tables and as pictures."""
