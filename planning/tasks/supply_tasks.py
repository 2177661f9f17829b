"""Tasks that no robot does: the cell itself brings parts to a source, and takes products away.

They are nodes of chains of their own, those of ``Workcell.machines``: an arrival is a node that
takes the time for which it is waited.
"""

from __future__ import annotations

ARRIVE = "arrive"
"""Kind of the task that waits until the next part has come along a conveyor."""

PRESENT = "present"
"""Kind of the task after which the next part, or a full tray, is where it is picked."""

LEAVE = "leave"
"""Kind of the task after which a finished product is gone."""

SUPPLY_KINDS = (ARRIVE, PRESENT, LEAVE)

GONE = "(gone)"
"""Stands for the holder of an object that has left the cell; no robot can have this name."""
