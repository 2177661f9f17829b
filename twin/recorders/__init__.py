"""Observers that keep the stream of events."""
