"""Efforts that joints needed for what was executed, by inverse dynamics with what was in hand."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio
from scipy import constants

from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.robots.descriptions.written_options import written_options
from planning.robots.descriptions.xml_reading import read_xml
from planning.robots.registry import ROBOTS
from planning.transforms import Array
from twin.audit.motion.executed import ObjectRow, Recording, RobotRows

_SAMPLE_S = 0.01
"""So often efforts are worked out at least while a robot moves [s]."""

_SPARE = 0.01
"""Share of its effort that gravity has to leave a joint which can be held to it."""


@dataclass(frozen=True, eq=False)
class RobotEfforts:
    """Efforts of a robot in a run.

    Attributes:
        t: times, shape (m,); those at which something changes hands are there twice, before and
            after it does [s].
        effort: of all joints then, shape (m, n) [N m, or N for joints that slide].
        limit: what its joints can exert, shape (n,), infinite where that is not known.
        borne: where gravity alone leaves a joint something to exert, and does so at HOME with
            nothing in hand, shape (m, n).
        unweighed: objects that the robot held and whose mass is not given: they count as nothing.
    """

    t: Array
    effort: Array
    limit: Array
    borne: npt.NDArray[np.bool_]
    unweighed: tuple[str, ...]


@dataclass(frozen=True)
class GreatestEffort:
    """The greatest effort of a joint in a run.

    Attributes:
        robot: its name.
        joint: its name.
        effort: with its sign [N m, or N for a joint that slides].
        limit: what the joint can exert [N m or N].
        share: of the limit.
        t_s: when [s].
        unweighed: see RobotEfforts.
    """

    robot: str
    joint: str
    effort: float
    limit: float
    share: float
    t_s: float
    unweighed: tuple[str, ...]


def efforts_of_run(cell: Workcell, recording: Recording) -> dict[str, RobotEfforts]:
    """Return the efforts of the robots that keep to limits of motion and have efforts and masses.

    A robot has masses where its description gives one to what its last joint moves.
    """
    objects = {item.name: item for item in cell.objects}
    found = {}
    for robot in cell.robots:
        rows, drives = recording.robots[robot.name], robot.model.drives
        if rows.v is None or len(rows.t) < 2 or robot.limits is None or drives is None:
            continue
        dynamics = _Dynamics(robot)
        limit = np.where(drives.effort > 0.0, drives.effort, np.inf)
        if dynamics.has_masses and np.any(np.isfinite(limit)):
            found[robot.name] = _efforts(dynamics, robot, limit, recording, objects)
    return found


def greatest_efforts(
    cell: Workcell, efforts: Mapping[str, RobotEfforts]
) -> Iterator[GreatestEffort]:
    """Yield the greatest effort of every joint of which it is known what it can exert."""
    for name, own in efforts.items():
        for j in np.flatnonzero(np.isfinite(own.limit)).tolist():
            worst = int(np.argmax(np.abs(own.effort[:, j])))
            effort, limit = float(own.effort[worst, j]), float(own.limit[j])
            joint = cell.robot(name).model.joint_names[j]
            share, at = abs(effort) / limit, float(own.t[worst])
            yield GreatestEffort(name, joint, effort, limit, share, at, own.unweighed)


def _efforts(
    dynamics: _Dynamics,
    robot: PlacedRobot,
    limit: Array,
    recording: Recording,
    objects: Mapping[str, CellObject],
) -> RobotEfforts:
    rows, changes = recording.robots[robot.name], list(recording.objects)
    room = (1.0 - _SPARE) * limit
    held: dict[str, ObjectRow] = {}
    bounds = sorted({float(rows.t[0]), float(rows.t[-1]), *(r.t for r in changes)})
    at_home = np.abs(dynamics.gravity(robot.home[None]))[0] <= room
    times, efforts, borne = [], [], []
    for begin, end in pairwise(bounds):
        while changes and changes[0].t <= begin:
            row = changes.pop(0)
            held.pop(row.object, None)
            if row.holder == robot.name:
                held[row.object] = row
        dynamics.hold([(objects[name], row) for name, row in held.items()])
        t = _samples(rows, begin, end)
        q, v, a = _states(rows, t)
        own = dynamics.efforts(q, v, a)
        can = np.repeat(at_home[None], len(t), axis=0)
        over = np.any(np.abs(own) > limit, axis=1)
        can[over] &= np.abs(dynamics.gravity(q[over])) <= room
        times.append(t)
        efforts.append(own)
        borne.append(can)
    names = dict.fromkeys(
        row.object for row in recording.objects if row.holder == robot.name
    )
    return RobotEfforts(
        np.concatenate(times),
        np.vstack(efforts),
        limit,
        np.vstack(borne),
        tuple(name for name in names if objects[name].mass <= 0.0),
    )


def _samples(rows: RobotRows, begin: float, end: float) -> Array:
    """Return the times of all rows in a span, its ends, and more while the robot moves."""
    low, high = np.searchsorted(rows.t, [begin, end])
    knots = np.unique(np.concatenate([[begin], rows.t[low:high], [end]]))
    assert rows.v is not None
    moves = np.any(rows.v != 0.0, axis=1)
    parts = [knots]
    for a, b in pairwise(knots.tolist()):
        k = int(np.searchsorted(rows.t, a, side="right"))
        if moves[max(k - 1, 0)] or moves[min(k, len(moves) - 1)]:
            count = int(np.ceil((b - a) / _SAMPLE_S))
            parts.append(np.linspace(a, b, count + 1)[1:-1])
    return np.unique(np.concatenate(parts))


def _states(rows: RobotRows, t: Array) -> tuple[Array, Array, Array]:
    """Return configurations, speeds and accelerations at some times, shape (m, n) each."""
    assert rows.v is not None
    assert rows.a is not None
    k = np.clip(np.searchsorted(rows.t, t, side="right") - 1, 0, len(rows.t) - 2)
    span, since = (rows.t[k + 1] - rows.t[k])[:, None], (t - rows.t[k])[:, None]
    jerk = (rows.a[k + 1] - rows.a[k]) / span
    v = rows.v[k] + since * (rows.a[k] + 0.5 * since * jerk)
    return rows.at(t), v, rows.a[k] + since * jerk


class _Dynamics:
    """The bodies of a robot with their masses, and of what it holds.

    Args:
        robot: names, file, joints and base are used.
    """

    def __init__(self, robot: PlacedRobot) -> None:
        model = pinocchio.buildModelFromUrdf(str(robot.model.urdf))
        model.gravity.linear = robot.base[:3, :3].T @ (0.0, 0.0, -constants.g)
        names = list(model.names)
        self._joints = [model.joints[names.index(n)] for n in robot.model.joint_names]
        self._flange = pinocchio.SE3(robot.model.flange)
        self._bare, self._model = model, model
        self._data = model.createData()
        self._still = pinocchio.neutral(model)
        moved = set(robot.model.joint_names)
        if held := [name for name in names[1:] if name not in moved]:
            known = written_options(read_xml(robot.model.urdf))
            frozen = (known or ROBOTS[robot.model.name]).frozen
            for name in held:
                self._still[model.joints[names.index(name)].idx_q] = frozen[name]
        last = names.index(robot.model.joint_names[-1])
        self._last = last
        beyond = [k for k in range(last, model.njoints) if last in model.supports[k]]
        self.has_masses = sum(model.inertias[k].mass for k in beyond) > 0.0

    def hold(self, held: Sequence[tuple[CellObject, ObjectRow]]) -> None:
        """Take into the hand what is held from now on, and nothing else."""
        self._model = self._bare.copy()
        for item, row in held:
            if item.mass > 0.0:
                box = pinocchio.Inertia.FromBox(item.mass, *item.size.tolist())
                body = pinocchio.Inertia(
                    item.mass, np.array(item.shape.centre_of_mass), box.inertia
                )
                pose = self._flange * pinocchio.SE3(row.pose)
                self._model.appendBodyToJoint(self._last, body, pose)
        self._data = self._model.createData()

    def gravity(self, q: Array) -> Array:
        """Return what joints exert to stand at some configurations, shape (m, n)."""
        return self.efforts(q, np.zeros_like(q), np.zeros_like(q))

    def efforts(self, q: Array, v: Array, a: Array) -> Array:
        """Return the efforts at some states, shape (m, n)."""
        out = np.empty_like(q)
        columns = [joint.idx_v for joint in self._joints]
        for k in range(len(q)):
            state = self._still.copy()
            for joint, value in zip(self._joints, q[k].tolist(), strict=True):
                if joint.nq == joint.nv:
                    state[joint.idx_q] = value
                else:  # a continuous joint is kept as the cosine and the sine of its angle
                    state[joint.idx_q : joint.idx_q + 2] = np.cos(value), np.sin(value)
            speed, rise = np.zeros(self._model.nv), np.zeros(self._model.nv)
            speed[columns], rise[columns] = v[k], a[k]
            found: Any = pinocchio.rnea(self._model, self._data, state, speed, rise)
            out[k] = found[columns]
        return out
