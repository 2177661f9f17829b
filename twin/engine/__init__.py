"""Discrete-event engine: SimPy processes of robots and dispatcher (APEX-MR IV-D).

Imports run, recorders.observers and uncertainty; trial, study and follow import it.
"""
