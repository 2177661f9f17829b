"""Robots that somebody else moves: the plan is executed by drivers, which the dispatcher tells how far they are cleared."""
