"""The world as planned so far: who is where, holds what, sweeps what, and what has been built."""
