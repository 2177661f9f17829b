"""Tasks that no robot does: the cell itself brings parts, works at them, and takes products away.

They are nodes of chains of their own, those of ``Workcell.machines``: an arrival is a node that
takes the time for which it is waited.
"""

from __future__ import annotations

import numpy as np

from planning.tasks.task import Handling
from planning.transforms import Transform, readonly

STILL = readonly(np.zeros((1, 1)))
"""Path of a machine, which does not move."""

ARRIVE = "arrive"
"""Kind of the task that waits until the next part has come along a conveyor."""

PRESENT = "present"
"""Kind of the task after which the next part, or a full tray, is where it is picked."""

LEAVE = "leave"
"""Kind of the task after which a finished product is gone."""

SUPPLY_KINDS = (ARRIVE, PRESENT, LEAVE)

DOOR = "door"
"""Kind of the object that is the door of a machine while that works."""

GONE = "(gone)"
"""Stands for the holder of an object that has left the cell; no robot can have this name."""


def door_shut(door: str, pose: Transform) -> tuple[Handling, Handling]:
    """Return how a door comes up when a task begins, and is gone when it is over.

    So nobody may be where it is for as long as the task may last, and it rests nowhere in between.
    """
    return Handling(door, 0, None, pose), Handling(door, 1, GONE, pose)
