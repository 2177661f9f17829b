"""Poses of robots and objects of a run at any time, its tasks and waits, and the bars of its Gantt chart."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from planning.cell.workcell import PlacedRobot
from planning.kinematics.kinematics import frame_pose
from planning.tasks.task import Handling
from planning.transforms import Array, Transform, from_quat_wxyz
from twin.activities.activities import IDLE, WAITING, robot_activities
from twin.drawing.lane_colours import plan_colours
from twin.durations.nanoseconds import NANOSECONDS
from twin.recorders.run_tables import FLANGE, WORLD
from twin.rerun.plan_descriptions import PlanDescriptions
from twin.runs.trajectory import Placement
from twin.trial.run_result import RunResult

_SAME_S = 1e-6
"""Times that differ by less are the same [s]."""


def world_poses(
    placements: Mapping[str, Placement],
    robots: Mapping[str, PlacedRobot],
    configurations: Mapping[str, Array],
) -> dict[str, Transform]:
    """Return the pose in the world of each placed object that is in the cell."""
    found = {}
    for name, own in placements.items():
        if own.holder is None:
            found[name] = own.pose
        elif own.holder != Handling.GONE:
            hand = frame_pose(robots[own.holder], configurations[own.holder])
            found[name] = hand @ own.pose
    return found


class RunPlayback:
    """A run as it is shown: configurations and poses at any time, bars, and times of events.

    Args:
        run: a run in memory or in a folder.

    Attributes:
        end_s: time of the last event [s].
        robots, motions: robots of the cell and their motions, by name.
    """

    def __init__(self, run: RunResult) -> None:
        self._run = run
        self.end_s = run.makespan_ns / NANOSECONDS
        self.robots = {robot.name: robot for robot in run.tpg.cell.robots}
        self.motions = run.motions
        self._placements: defaultdict[str, list[Placement]] = defaultdict(list)
        for row in run.objects.to_pylist():
            parent = str(row["parent"])
            holder = parent.removesuffix(f"/{FLANGE}")
            self._placements[row["object"]].append(
                Placement(
                    round(row["t_s"] * NANOSECONDS),
                    row["object"],
                    None if parent == WORLD else holder,
                    from_quat_wxyz(row["xyz"], row["quat_wxyz"]),
                )
            )

    def configurations(self, t_s: float) -> dict[str, Array]:
        """Return the configuration of each robot at a time [s]."""
        at = np.array([round(t_s * NANOSECONDS)])
        return {name: own.at(at)[0] for name, own in self.motions.items()}

    def objects(
        self, t_s: float, configurations: dict[str, Array]
    ) -> dict[str, Transform]:
        """Return the pose in the world of each object that is in the cell at a time.

        Args:
            t_s: the time [s].
            configurations: of the robots then.
        """
        t_ns, placed = round(t_s * NANOSECONDS), {}
        for name, rows in self._placements.items():
            if k := bisect_right(rows, t_ns, key=lambda row: row.t_ns):
                placed[name] = rows[k - 1]
        return world_poses(placed, self.robots, configurations)

    def bar(self, lane: str, t_s: float, ahead: int = 0) -> list[Any]:
        """Return the bar of a lane that has begun last at a time, or one ahead of it; empty for none."""
        bars = self._bars.get(lane, [])
        k = bisect_right(bars, t_s, key=lambda bar: float(bar[0])) - 1 + ahead
        return bars[k] if 0 <= k < len(bars) else []

    @cached_property
    def _bars(self) -> dict[str, list[Any]]:
        return {lane["name"]: lane["bars"] for lane in self.chart["lanes"]}

    @cached_property
    def event_times_s(self) -> list[float]:
        """Times at which anything happens, in order [s]."""
        return sorted({event.t_ns / NANOSECONDS for event in self._run.history})

    def neighbour_s(self, t_s: float, *, backwards: bool) -> float:
        """Return the time of the next event after a time, or of the last one before it [s]."""
        times = [0.0, *self.event_times_s, self.end_s]
        if backwards:
            return times[max(bisect_left(times, t_s - _SAME_S) - 1, 0)]
        return times[min(bisect_right(times, t_s + _SAME_S), len(times) - 1)]

    @cached_property
    def chart(self) -> dict[str, Any]:
        """Return the lanes of the Gantt chart as JSON values.

        Keys: ``end_s``, ``colours`` by state, ``lanes``: name and bars, each a list of start [s], end [s],
        state, a description, and of a wait the body that is waited for.
        """
        tpg = self._run.tpg
        words = PlanDescriptions(tpg)
        ends = [end for _, end in self._run.node_times_ns]
        lanes = []
        lanes_of = robot_activities(tpg, self._run.history)
        for k, (lane, activities) in enumerate(lanes_of.items()):
            bars: list[list[Any]] = []
            for item in activities:
                if item.state == IDLE:
                    continue
                said, awaited = words.state(item.state, item.task), ""
                if item.state == WAITING:

                    def complete(
                        other: int, node: int, at: int = item.start_ns
                    ) -> bool:
                        return 0 <= int(ends[other][node]) <= at

                    said = words.wait(k, item.first, complete) or said
                    for other, node in words.awaited(k, item.first, complete)[-1:]:
                        owner = tpg.chains[other]
                        part = tpg.tasks[int(owner.task[node])].object
                        robot = owner.robot in self.robots
                        awaited = (
                            f"robots/{owner.robot}" if robot else f"objects/{part}"
                        )
                start, end = item.start_ns / NANOSECONDS, item.end_ns / NANOSECONDS
                bars.append([start, end, item.state, said, awaited])
            if bars:
                lanes.append({"name": lane, "bars": bars})
        return {"end_s": self.end_s, "colours": plan_colours(tpg), "lanes": lanes}
