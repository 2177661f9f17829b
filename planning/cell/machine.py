"""Machines: what brings parts, works at them or takes them away, as far as a plan has to know.

A machine is something whose tasks take time and wait for others, as those of a robot do. It has
no body: what it brings, works at or takes are objects at rest, and the user's fixtures stand for
its frame. So is its door, for as long as it works.
"""

from __future__ import annotations

import numpy as np

from planning.cell.immovable import immovable
from planning.cell.workcell import PlacedRobot
from planning.transforms import readonly

MODEL = immovable("machine")
"""A slide that never moves and carries nothing."""


def machine(name: str) -> PlacedRobot:
    """Return the machine of a name."""
    return PlacedRobot(name, MODEL, readonly(np.eye(4)), MODEL.home)
