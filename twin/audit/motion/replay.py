"""Where all objects are at any time of an execution: the one state machine that all rules look at."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planning.cell.workcell import Workcell
from planning.tasks.task import GONE
from planning.transforms import Transform
from twin.audit.motion.executed import ObjectRow, Recording


@dataclass(frozen=True, eq=False)
class Stay:
    """An object in one place for a while.

    Attributes:
        object: its name.
        holder: the robot that holds it, None at rest, GONE once it has left the cell.
        pose: of the object's centre, in the holder's flange frame or in the world.
        t: since when; several may be of one moment, of which the last one counts [s].
        until: when the next one begins; infinite for the last one [s].
        giver: who held it before, None where nobody did.
    """

    object: str
    holder: str | None
    pose: Transform
    t: float
    until: float
    giver: str | None


class Replay:
    """The objects of an execution.

    Args:
        cell: says where objects are that the recording says nothing of.
        recording: what was executed.

    Attributes:
        cell: see there.
        robots: rows of every robot.
        end: time of the last row [s].
        stays: of each object in their order, the one at its start first.
        in_order: all stays by time.
    """

    def __init__(self, cell: Workcell, recording: Recording) -> None:
        self.cell, self.robots, self.end = cell, recording.robots, recording.end
        rows: dict[str, list[ObjectRow]] = {
            item.name: []
            if item.later
            else [ObjectRow(0.0, item.name, None, item.start)]
            for item in cell.objects
        }
        for row in recording.objects:
            own = rows[row.object]
            if row.t <= 0.0 and own:
                own.clear()
            own.append(row)
        self.stays = {name: tuple(_stays(own)) for name, own in rows.items()}
        every = (stay for own in self.stays.values() for stay in own)
        self.in_order = sorted(every, key=lambda stay: stay.t)

    def handed(self) -> Iterator[Stay]:
        """Yield all stays that begin after the start, by time."""
        return (stay for stay in self.in_order if stay.t > 0.0)

    def states(self, *times: float) -> Iterator[tuple[float, dict[str, Stay]]]:
        """Yield 0, every time at which something changes hands, and given ones, in order [s].

        With each comes where everything is that is there from then on.
        """
        there: dict[str, Stay] = {}
        left = deque(self.in_order)
        for t in sorted({0.0, *times, *(stay.t for stay in self.handed())}):
            while left and left[0].t <= t:
                stay = left.popleft()
                there[stay.object] = stay
                if stay.holder == GONE:
                    del there[stay.object]
            yield t, dict(there)

    def place(self, name: str, t: float = np.inf) -> Stay | None:
        """Return where an object is at a time [s], by default at the end; None if it is not there."""
        now = [stay for stay in self.stays.get(name, ()) if stay.t <= t]
        return now[-1] if now and now[-1].holder != GONE else None

    def at(self, t: float = np.inf) -> dict[str, Stay]:
        """Return where every object that is there is at a time [s], by default at the end."""
        places = ((name, self.place(name, t)) for name in self.stays)
        return {name: stay for name, stay in places if stay is not None}

    def held(self, robot: str) -> Iterator[tuple[float, float, list[Stay]]]:
        """Yield spans of a robot's rows, and what is in its hand in each, from change to change [s]."""
        ends = self.robots[robot].t[[0, -1]].tolist()
        for (begin, there), (end, _) in pairwise(self.states(*ends)):
            own = [stay for stay in there.values() if stay.holder == robot]
            yield begin, end, own


def _stays(rows: list[ObjectRow]) -> Iterator[Stay]:
    giver = None
    for row, until in zip(rows, [*(row.t for row in rows[1:]), np.inf], strict=True):
        yield Stay(row.object, row.holder, row.pose, row.t, until, giver)
        giver = row.holder
