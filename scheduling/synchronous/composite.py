"""Robots that move simultaneously, planned as one robot with all their joints (APEX-MR V-A).

A composite configuration is the concatenation of the configurations of all robots. On a straight line between two of
them, all robots move in proportion, in lock step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np

from planning.cell.workcell import Workcell, WorldState
from planning.geometry.scene_checker import SceneChecker
from planning.joint_motion.moving_pairs import MovingPair
from planning.motion.motion_plan import TaskMotion
from planning.motion.speed import SpeedModel
from planning.tasks.task import AllowedContact, allowed_pairs
from planning.transforms import Array


@dataclass(frozen=True)
class CompositeSpeed(SpeedModel):
    """Speed model of robots that move in lock step: the slowest one decides.

    Attributes:
        speeds: of each robot, in the order of their joints.
        joints: where each robot's joints are.
    """

    speeds: tuple[SpeedModel, ...]
    joints: tuple[slice, ...]

    def durations(self, travel: Array) -> Array:
        """Return the times of motions in lock step, composite shape (..., n) [s]."""
        each = [
            speed.durations(travel[..., own])
            for speed, own in zip(self.speeds, self.joints, strict=True)
        ]
        return np.asarray(np.max(each, axis=0))


class CompositeChecker:
    """Collision checks of robots that move simultaneously, everything else static.

    Motions keep their clearance part by part, see ``planning.geometry.separation``.

    Args:
        cell: the static cell.
        tasks: index of the current task of each robot that moves, by name; its order is that of the
            joints.
        state: world state at the start.
        last_task: last task of each standing robot.
        allowed: the table of allowed contacts.
        speeds: speed model of each robot.
        step: longest time of a part [s].
        margin: added to the cell's clearances [m].
    """

    def __init__(
        self,
        cell: Workcell,
        tasks: Mapping[str, int],
        state: WorldState,
        last_task: Mapping[str, int],
        allowed: Sequence[AllowedContact],
        speeds: Mapping[str, SpeedModel],
        *,
        step: float,
        margin: float = 0.0,
    ) -> None:
        self.robots = tuple(tasks)
        ends = np.cumsum([0, *(cell.robot(name).model.dof for name in tasks)]).tolist()
        self.joints = tuple(slice(a, b) for a, b in pairwise(ends))
        self.speed = CompositeSpeed(
            tuple(speeds[name] for name in self.robots), self.joints
        )
        self._step = step
        under_way = {**last_task, **tasks}
        pairs = {
            name: allowed_pairs(cell, state, name, tasks[name], under_way, allowed)
            for name in self.robots
        }
        self._alone = tuple(
            SceneChecker(
                without_robots(cell, state, [o for o in self.robots if o != name]),
                name,
                state,
                pairs[name],
                margin=margin,
            )
            for name in self.robots
        )
        self._together = tuple(
            (
                i,
                k,
                MovingPair(
                    cell,
                    self.robots[i],
                    self.robots[k],
                    state,
                    pairs[self.robots[i]] & pairs[self.robots[k]],
                    margin=margin,
                ),
            )
            for i, k in combinations(range(len(self.robots)), 2)
        )

    def configuration_free(self, q: Array) -> bool:
        """Tell whether all robots may stand at composite ``q``, shape (n,)."""
        joints = self.joints
        return all(
            pair.clear(q[joints[i]], q[joints[k]]) for i, k, pair in self._together
        ) and all(
            alone.configuration_free(np.ascontiguousarray(q[own]))
            for alone, own in zip(self._alone, joints, strict=True)
        )

    def motion_free(self, q_a: Array, q_b: Array) -> bool:
        """Tell whether the composite line from ``q_a`` to ``q_b`` is free, shape (n,)."""
        return self.configuration_free(q_b) and self.split(q_a, q_b) is not None

    def seems_free(self, q_a: Array, q_b: Array) -> bool:
        """Tell whether some configurations of the line are free, shape (n,) each."""
        joints = self.joints
        middle = 0.5 * (q_a + q_b)
        return all(
            pair.clear(q[joints[i]], q[joints[k]])
            for q in (q_b, middle)
            for i, k, pair in self._together
        ) and all(
            alone.seems_free(q_a[own], q_b[own])
            for alone, own in zip(self._alone, joints, strict=True)
        )

    def split(self, q_a: Array, q_b: Array) -> Array | None:
        """Cut a composite line into parts that can become nodes.

        Returns:
            The parameters at which parts end, rising to 1; None where the line is not free.
        """
        seconds = self.speed.duration(q_a, q_b)
        parts = max(1, int(np.ceil(seconds / self._step - 1e-9)))
        ends = np.arange(1, parts + 1) / parts
        for i, k, pair in self._together:
            first, second = self.joints[i], self.joints[k]
            own = pair.split(q_a[first], q_b[first], q_a[second], q_b[second], parts)
            if own is None:
                return None
            ends = np.union1d(ends, own)
        for alone, own_joints in zip(self._alone, self.joints, strict=True):
            a = np.ascontiguousarray(q_a[own_joints])
            b = np.ascontiguousarray(q_b[own_joints])
            if not alone.motion_free(a, b):
                return None
        ends[-1] = 1.0
        return ends

    def motions(self, path: Array) -> dict[str, TaskMotion] | None:
        """Return the motion of each robot on a composite polyline, times from 0.

        Args:
            path: shape (w, n).

        Returns:
            Waypoints at the same times for all robots, None where the path is not free.
        """
        waypoints, times = [path[0]], [0.0]
        for q_a, q_b in zip(path, path[1:], strict=False):
            seconds = self.speed.duration(q_a, q_b)
            if seconds <= 0.0:
                continue
            ends = self.split(q_a, q_b)
            if ends is None:
                return None
            begin = times[-1]
            for t in ends.tolist():
                waypoints.append(q_b if t == 1.0 else q_a + t * (q_b - q_a))
                times.append(begin + t * seconds)
        whole = np.array(waypoints)
        return {
            name: TaskMotion(np.ascontiguousarray(whole[:, own]), np.array(times))
            for name, own in zip(self.robots, self.joints, strict=True)
        }


def without_robots(
    cell: Workcell, state: WorldState, robots: Sequence[str]
) -> Workcell:
    """Return a cell without some robots and their loads."""
    return replace(
        cell,
        robots=tuple(r for r in cell.robots if r.name not in robots),
        objects=tuple(
            item
            for item in cell.objects
            if item.name not in state.attachments
            or state.attachments[item.name].holder not in robots
        ),
    )
