"""Discrete-event engine: SimPy processes of robots and dispatcher (APEX-MR IV-D).

Imports runs, recorders.observers and uncertainty; trial, studies and follow import it.
"""
