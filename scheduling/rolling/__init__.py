"""The rolling graph: a plan that is cut while it is executed, and extended from the world at the cut."""
