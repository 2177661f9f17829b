"""Names of robots in 3-D, each with that of what it holds; what lies still is named on hovering.

They stand at the robots' feet: a name beside a part would hide it, and where several robots work
at one place the names would hide the work.
"""

from __future__ import annotations

from collections.abc import Iterable

import rerun as rr

from planning.tasks.supply_tasks import GONE
from twin.recorders.rerun.robots import name_entity
from twin.recorders.rerun.time_and_pose import time_column
from twin.run.trajectory import Placement


class RobotNames:
    """Takes placements of objects by time, and writes what each robot's name is from when on."""

    def __init__(self, rec: rr.RecordingStream, robots: Iterable[str]) -> None:
        """Begin with empty hands."""
        self._rec = rec
        self._holder: dict[str, str] = {}
        self._rows = {robot: [(0, robot)] for robot in robots}

    def take(self, placement: Placement) -> None:
        """Take note that an object has changed hands."""
        before = self._holder.pop(placement.object, None)
        if before is not None:
            self._rows[before].append((placement.t_ns, before))
        robot = placement.holder
        if robot not in (None, GONE):
            name = f"{robot}: {placement.object}"
            self._rows[robot].append((placement.t_ns, name))
            self._holder[placement.object] = robot

    def send(self) -> None:
        """Write what there is since the last time."""
        for robot, rows in self._rows.items():
            if rows:
                self._rec.send_columns(
                    name_entity(robot),
                    indexes=[time_column([t_ns for t_ns, _ in rows])],
                    columns=rr.Points3D.columns(labels=[name for _, name in rows]),
                )
        self._rows = {robot: [] for robot in self._rows}
