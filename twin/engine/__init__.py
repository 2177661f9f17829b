"""Discrete-event engine: SimPy processes of robots and dispatcher (APEX-MR IV-D).

Begin with ``Execution`` in execution.py: it has the state of a run, and releases nodes to robots.
Imports runs, recorders.observers and uncertainty; trial, studies and follow import it.
"""
