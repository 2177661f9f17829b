"""Table of a cell, what stands on it, and the place for an assembly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.cell.workcell import Workcell
from planning.errors import RequestError
from planning.transforms import Array

_BEST_DISTANCE = 0.5
"""Distance of the assembly from the bases of the robots that is best [m]."""

_FROM_ROBOT, _FROM_FIXTURE = 0.2, 0.08
"""Room for hands around bases of robots, and fixtures on the table [m]."""

_STEP = 0.02
"""Step between places of the assembly that are tried [m]."""


class Area(NamedTuple):
    """A rectangle seen from above: its corners, shape (2,) [m]."""

    low: Array
    high: Array


@dataclass(frozen=True)
class Table:
    """A table, and what stands on it.

    Attributes:
        area: its top.
        top: height of that [m].
        obstacles: what stands there, with the room that it needs [m].
        middle: of the assembly, shape (2,) [m].
    """

    area: Area
    top: float
    obstacles: list[tuple[Area, float]]
    middle: Array

    def is_free(
        self, at: Array, area: Area, room: float = 0.0
    ) -> npt.NDArray[np.bool_]:
        """Tell at which places, shape (n, 2), an area has some room around it among the obstacles [m]."""
        free = np.ones(len(at), dtype=bool)
        for other, kept in self.obstacles:
            apart = np.maximum(at + area.low - other.high, other.low - at - area.high)
            free &= apart.max(axis=1) >= max(room, kept)
        return free


def find_table(cell: Workcell, base: str) -> Table:
    """Return the largest fixture as a table, with what stands on it; the base of the assembly does not count.

    Raises:
        RequestError: there is no other fixture.
    """
    boxes = {}
    for item in cell.fixtures:
        if item.name != base:
            points = np.vstack([piece.vertices for piece in item.shape.pieces])
            points = points @ item.pose[:3, :3].T + item.pose[:3, 3]
            boxes[item.name] = points.min(axis=0), points.max(axis=0)
    if not boxes:
        raise RequestError("the cell has no fixture that could be a table")
    name = max(boxes, key=lambda own: float(np.prod(np.ptp(boxes[own], axis=0)[:2])))
    low, high = boxes.pop(name)
    obstacles = [
        (Area(a[:2], b[:2]), _FROM_FIXTURE)
        for a, b in boxes.values()
        if b[2] > high[2] + 1e-3
    ]
    bases = (robot.base[:2, 3] for robot in cell.robots)
    obstacles += [(Area(at, at), _FROM_ROBOT) for at in bases]
    area = Area(low[:2], high[:2])
    return Table(area, float(high[2]), obstacles, 0.5 * (low + high)[:2])


def best_place(
    table: Table, area: Area, bases: Sequence[Array]
) -> tuple[float, float] | None:
    """Return where on a table an assembly is at the best distance from all robots; None where it has no room [m].

    Its area is seen from its middle, and the robots' bases from above, each of shape (2,) [m].
    """
    centre = 0.5 * (table.area.low + table.area.high)
    counts = ((table.area.high - centre) / _STEP).astype(int)
    steps = (_STEP * np.arange(-count, count + 1) for count in counts)
    at = centre + np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
    free = np.all(at + area.low >= table.area.low, axis=1)
    free &= np.all(at + area.high <= table.area.high, axis=1)
    at = at[free & table.is_free(at, area)]
    if not len(at):
        return None
    away = np.linalg.norm(at[:, None] - np.array(bases), axis=2)
    worst = np.abs(away - _BEST_DISTANCE).max(axis=1)
    order = np.lexsort((np.linalg.norm(at - centre, axis=1), np.round(worst, 6)))
    x, y = np.round(at[order[0]], 6).tolist()
    return x, y
