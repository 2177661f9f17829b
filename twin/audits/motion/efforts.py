"""Joint efforts in an executed run, computed by inverse dynamics including held objects.

The module also computes the speeds of tools that have a speed limit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pinocchio
from scipy import constants

from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.transforms import Array
from scheduling.witness.robot import WitnessRobot
from twin.audits.motion.executed import ReplayedRun, Stay

_SPARE = 0.01
"""Share of a joint's effort limit that gravity must leave for the limit to be checked."""


@dataclass(frozen=True, eq=False)
class RobotEfforts:
    """Efforts of a robot in a run.

    Attributes:
        t: times, shape (m,); those of object transfers are there twice, before and
            after it does [s].
        effort: of all joints then, shape (m, n) [N m, or N for joints that slide].
        limit: effort limits, shape (n,), infinite if unknown.
        borne: where gravity alone leaves a joint something to exert, and does so at HOME with
            nothing in hand, shape (m, n).
        unweighed: held objects without a mass, which count as massless.
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
        limit: effort limit of the joint [N m or N].
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


def efforts_of_run(replay: ReplayedRun) -> dict[str, RobotEfforts]:
    """Return the efforts of robots with motion limits, effort limits and masses.

    A robot has masses where its description gives one to what its last joint moves.
    """
    found = {}
    for robot in replay.cell.robots:
        rows, drives = replay.robots[robot.name], robot.model.drives
        if rows.v is None or len(rows.t) < 2 or robot.limits is None or drives is None:
            continue
        dynamics = _Dynamics(robot)
        limit = np.where(drives.effort > 0.0, drives.effort, np.inf)
        if dynamics.has_masses and np.any(np.isfinite(limit)):
            found[robot.name] = _efforts(dynamics, robot, limit, replay)
    return found


def greatest_efforts(
    cell: Workcell, efforts: Mapping[str, RobotEfforts]
) -> Iterator[GreatestEffort]:
    """Yield the greatest effort of every joint with a known limit."""
    for name, own in efforts.items():
        for j in np.flatnonzero(np.isfinite(own.limit)).tolist():
            worst = int(np.argmax(np.abs(own.effort[:, j])))
            effort, limit = float(own.effort[worst, j]), float(own.limit[j])
            joint = cell.robot(name).model.joint_names[j]
            share, at = abs(effort) / limit, float(own.t[worst])
            yield GreatestEffort(name, joint, effort, limit, share, at, own.unweighed)


def _efforts(
    dynamics: _Dynamics, robot: PlacedRobot, limit: Array, replay: ReplayedRun
) -> RobotEfforts:
    rows, objects = replay.robots[robot.name], replay.cell.objects
    room = (1.0 - _SPARE) * limit
    at_home = np.abs(dynamics.gravity(robot.home[None]))[0] <= room
    times, efforts, borne = [], [], []
    for begin, end, held in replay.held(robot.name):
        dynamics.hold([(replay.cell.object(stay.object), stay) for stay in held])
        t = rows.moving_samples(begin, end)
        q, v, a = rows.states(t)
        own = dynamics.efforts(q, v, a)
        can = np.repeat(at_home[None], len(t), axis=0)
        over = np.any(np.abs(own) > limit, axis=1)
        can[over] &= np.abs(dynamics.gravity(q[over])) <= room
        times.append(t)
        efforts.append(own)
        borne.append(can)
    weightless = {item.name for item in objects if item.mass <= 0.0}
    names = [stay.object for stay in replay.in_order if stay.holder == robot.name]
    return RobotEfforts(
        np.concatenate(times),
        np.vstack(efforts),
        limit,
        np.vstack(borne),
        tuple(name for name in dict.fromkeys(names) if name in weightless),
    )


class _Dynamics:
    """Bodies with masses of a robot and its held object.

    Args:
        robot: names, file, joints and base are used.
    """

    def __init__(self, robot: PlacedRobot) -> None:
        self._arm = WitnessRobot(robot)
        model = self._arm.model
        model.gravity.linear = robot.base[:3, :3].T @ (0.0, 0.0, -constants.g)
        self._flange = pinocchio.SE3(robot.model.flange)
        self._bare, self._model = model, model
        self._data = model.createData()
        self.has_masses = model.inertias[self._arm.dof].mass > 0.0

    def hold(self, held: Sequence[tuple[CellObject, Stay]]) -> None:
        """Set the held objects."""
        self._model = self._bare.copy()
        for item, stay in held:
            if item.mass > 0.0:
                box = pinocchio.Inertia.FromBox(item.mass, *item.size.tolist())
                body = pinocchio.Inertia(
                    item.mass, np.array(item.shape.centre_of_mass), box.inertia
                )
                pose = self._flange * pinocchio.SE3(stay.pose)
                self._model.appendBodyToJoint(self._arm.dof, body, pose)
        self._data = self._model.createData()

    def gravity(self, q: Array) -> Array:
        """Return the gravity efforts at given configurations, shape (m, n)."""
        return self.efforts(q, np.zeros_like(q), np.zeros_like(q))

    def efforts(self, q: Array, v: Array, a: Array) -> Array:
        """Return the efforts at given states, shape (m, n)."""
        out = np.empty_like(q)
        for k in range(len(q)):
            at = self._arm.state(q[k])
            out[k] = pinocchio.rnea(self._model, self._data, at, v[k], a[k])
        return out


@dataclass(frozen=True, eq=False)
class ToolSpeeds:
    """Speeds of a robot's tool while its held object stays the same.

    Attributes:
        robot: its name.
        t: times, shape (m,) [s].
        speed: of the tool's frame then, of the flange where there is none, shape (m,) [m/s].
        limit: for what it holds [m/s].
        loaded: whether it holds a part.
    """

    robot: str
    t: Array
    speed: Array
    limit: float
    loaded: bool


def tool_speeds_of_run(replay: ReplayedRun) -> Iterator[ToolSpeeds]:
    """Yield the speeds of all speed-limited tools, between changes of the held object."""
    for robot in replay.cell.robots:
        limits, rows = robot.limits, replay.robots[robot.name]
        if limits is None or rows.v is None or len(rows.t) < 2:
            continue
        if np.isinf(min(limits.tool_speed, limits.loaded_tool_speed)):
            continue
        arm, tools = WitnessRobot(robot), {tool.name for tool in robot.tools}
        for begin, end, held in replay.held(robot.name):
            names = {stay.object for stay in held}
            loaded = bool(names - tools)
            limit = limits.tool_speed
            if loaded:
                limit = min(limit, limits.loaded_tool_speed)
            if np.isfinite(limit):
                t = rows.moving_samples(begin, end)
                q, v, _ = rows.states(t)
                speed = arm.point_speeds(q, v, _tip(robot, names))
                yield ToolSpeeds(robot.name, t, speed, limit, loaded)


def _tip(robot: PlacedRobot, held: set[str]) -> Array:
    """Return the origin of the tool's frame in the last joint's, shape (3,) [m]."""
    worn = [tool.model for tool in robot.tools if tool.name in held]
    model = worn[0] if worn else robot.model
    frame = model.frames.get("tool", np.eye(4))
    return np.asarray((model.flange @ frame)[:3, 3])
