"""Discrete-event engine: SimPy processes of robots and dispatcher (APEX-MR IV-D).

Imports run, recorders.observers and uncertainty; trial and study import it.
"""
