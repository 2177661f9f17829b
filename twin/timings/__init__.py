"""Synthetic durations of the LEGO manipulation skills; README.md says what they are."""
