"""Execution records modified such that tools deviate from their reference paths in skills, as under force control."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from planning.cell.workcell import PlacedRobot, Workcell
from planning.geometry.robot_bodies import UNREACHED, flange_jacobians
from planning.kinematics.kinematics import joint_poses_of
from planning.transforms import Array
from twin.audits.motion.executed import STANDING, Recording, RobotRows

_SAMPLE_S = 0.01
"""So often a deviating robot has a row [s]."""

_EDGE = 0.2
"""Share of a node in which a deviation comes up, and in which it goes again."""

_TURNS = 6
"""Steps of inverse kinematics: each squares what is left of the error."""


def with_flange_deviations(
    cell: Workcell, recording: Recording, twists: Mapping[tuple[str, int], Array]
) -> Recording:
    """Return an execution with flange deviations.

    In each named node the flange deviates, by inverse kinematics, by a displacement and rotation that
    build up within the first fifth of the node's motion, stay constant, and vanish at its end.
    Standstills before and after are on the path.

    Args:
        cell: the robots.
        recording: the execution.
        twists: by robot and node, displacement and rotation vector in the world, shape (6,) [m, rad].
    """
    robots = {}
    for name, rows in recording.robots.items():
        own = {node: twist for (robot, node), twist in twists.items() if robot == name}
        robots[name] = _deviated(cell.robot(name), rows, own) if own else rows
    return replace(recording, robots=robots)


def _deviated(
    robot: PlacedRobot, rows: RobotRows, twists: Mapping[int, Array]
) -> RobotRows:
    for node, twist in twists.items():
        inside = np.flatnonzero(rows.node == node)
        if not len(inside):
            continue
        first, last = max(int(inside[0]) - 1, 0), int(inside[-1])
        while first < last and _same(rows.q[first], rows.q[first + 1]):
            first += 1
        while last > first and _same(rows.q[last], rows.q[last - 1]):
            last -= 1
        if rows.t[last] > rows.t[first]:
            rows = _beside(robot, rows, (first, last), twist)
    return rows


def _same(q: Array, other: Array) -> bool:
    return bool(np.all(np.abs(q - other) <= STANDING))


def _beside(
    robot: PlacedRobot, rows: RobotRows, span: tuple[int, int], twist: Array
) -> RobotRows:
    """Return rows with a deviation between two rows."""
    first, last = span
    begin, end = float(rows.t[first]), float(rows.t[last])
    t = rows.moving_samples(begin, end, _SAMPLE_S)
    # The deviation changes with motion only, not during standstills.
    path = rows.at(t)
    moves = np.any(np.abs(np.diff(path, axis=0)) > STANDING, axis=1)
    moved = np.cumsum(np.append(0.0, np.where(moves, np.diff(t), 0.0)))
    x = moved / moved[-1]
    rising = np.clip(np.minimum(x, 1.0 - x) / _EDGE, 0.0, 1.0)
    share = rising**2 * (3.0 - 2.0 * rising)
    off = np.stack(
        [_beside_at(robot, q, s * twist) for q, s in zip(path, share, strict=True)]
    )
    node = np.full(len(t), rows.node[last])
    node[0] = rows.node[first]
    new = {"t": t, "q": path + off, "node": node}
    if rows.v is not None:
        new["v"] = rows.states(t)[1] + np.gradient(off, t, axis=0)
        new["a"] = np.gradient(new["v"], t, axis=0)
    changed: dict[str, Any] = {
        name: np.concatenate(
            [getattr(rows, name)[:first], own, getattr(rows, name)[last + 1 :]]
        )
        for name, own in new.items()
    }
    return replace(rows, **changed)


def _beside_at(robot: PlacedRobot, q: Array, twist: Array) -> Array:
    """Return the joint displacement for a twist of the flange, shape (n,)."""
    flange, now = robot.model.flange, np.array(q)
    here = joint_poses_of(robot, q)[-1] @ flange
    turned = Rotation.from_rotvec(twist[3:]).as_matrix() @ here[:3, :3]
    for _ in range(_TURNS):
        frames = joint_poses_of(robot, now)
        at = frames[-1] @ flange
        left = Rotation.from_matrix(turned @ at[:3, :3].T).as_rotvec()
        error = np.concatenate([here[:3, 3] + twist[:3] - at[:3, 3], left])
        jacobian = flange_jacobians(robot, frames[None])[0]
        now += np.linalg.pinv(jacobian, rcond=UNREACHED) @ error
    return np.asarray(now - q)
