"""Disturbances, reproducible random draws, and the node times of a replication that result from them."""
