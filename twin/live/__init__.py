"""Robots moved by drivers, which execute the nodes that the dispatcher clears."""
