"""Names of what robots hold, shown beside it in 3-D; what lies still is named on hovering."""

from __future__ import annotations

from collections.abc import Iterable

import rerun as rr

from twin.recorders.rerun import layout as layout
from twin.recorders.rerun.layout import LABEL_COLOUR, entity_path
from twin.recorders.rerun.robots import flange_frame
from twin.recorders.rerun.time_and_pose import time_column
from twin.run.trajectory import Placement


class HeldNames:
    """Takes placements of objects by time, and writes which robot holds what from when on."""

    def __init__(self, rec: rr.RecordingStream, robots: Iterable[str]) -> None:
        """Begin with empty hands."""
        self._rec = rec
        self._holder: dict[str, str] = {}
        self._rows: dict[str, list[tuple[int, Placement | None]]] = {
            robot: [(0, None)] for robot in robots
        }

    def take(self, placement: Placement) -> None:
        """Take note that an object has changed hands."""
        before = self._holder.pop(placement.object, None)
        if before is not None:
            self._rows[before].append((placement.t_ns, None))
        if placement.holder is not None:
            self._rows[placement.holder].append((placement.t_ns, placement))
            self._holder[placement.object] = placement.holder

    def send(self) -> None:
        """Write what there is since the last time."""
        for robot, rows in self._rows.items():
            if rows:
                self._send(robot, rows)
        self._rows = {robot: [] for robot in self._rows}

    def _send(self, robot: str, rows: list[tuple[int, Placement | None]]) -> None:
        held = [placement for _, placement in rows if placement is not None]
        names = rr.Points3D.columns(
            positions=[item.pose[:3, 3] for item in held],
            labels=[item.object for item in held],
            colors=[LABEL_COLOUR] * len(held),
            radii=[0.001] * len(held),
        )
        frames = rr.CoordinateFrame.columns(frame=[flange_frame(robot)] * len(rows))
        self._rec.send_columns(
            entity_path(layout.HELD, robot),
            indexes=[time_column([t_ns for t_ns, _ in rows])],
            columns=[
                *frames,
                *names.partition([int(item is not None) for _, item in rows]),
            ],
        )
