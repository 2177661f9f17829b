"""Execution of a plan by drivers: each driver moves a robot through the nodes that the dispatcher permits."""
