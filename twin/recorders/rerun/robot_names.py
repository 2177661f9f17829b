"""Names of robots in 3-D, each with that of what it holds; what lies still is named on hovering.

They stand at the robots' feet: a name beside a part would hide it, and where several robots work
at one place the names would hide the work.
"""

from __future__ import annotations

from collections.abc import Iterable

import rerun as rr

from twin.recorders.rerun.robots import name_entity
from twin.recorders.rerun.time_and_pose import time_column
from twin.run.trajectory import Placement


class RobotNames:
    """Takes placements of objects by time, and writes what each robot's name is from when on."""

    def __init__(self, rec: rr.RecordingStream, robots: Iterable[str]) -> None:
        """Begin with empty hands."""
        self._rec = rec
        self._held: dict[str, list[str]] = {robot: [] for robot in robots}
        self._rows = {robot: [(0, robot)] for robot in self._held}

    def take(self, placement: Placement) -> None:
        """Take note that an object has changed hands."""
        for robot, held in self._held.items():
            had = placement.object in held
            if had:
                held.remove(placement.object)
            if robot == placement.holder:
                held.append(placement.object)
            if had or robot == placement.holder:
                name = f"{robot}: {', '.join(held)}" if held else robot
                self._rows[robot].append((placement.t_ns, name))

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
