"""Discrete-event engine: SimPy processes of robots and dispatcher (APEX-MR, Section IV-D).

Start reading at ``Execution`` in execution.py, which holds the state of a run and releases nodes to robots.
Imports runs, recorders.observers and uncertainty; trial, studies and follow import it.
"""
