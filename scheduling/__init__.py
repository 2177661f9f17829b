"""From a motion plan to a temporal plan graph: which motion must wait for which."""
