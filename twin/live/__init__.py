"""Execution of a plan by drivers, which move the robots through the nodes cleared by the dispatcher."""
