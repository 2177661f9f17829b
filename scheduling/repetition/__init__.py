"""Graphs of many products, made of the graph of a few by shifting it.

Imports conflicts and graph; twin.planning imports it.
"""
