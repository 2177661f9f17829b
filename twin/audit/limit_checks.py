"""Limits of motion: speeds, accelerations, jerks and efforts of what was executed, by its tables.

Limits of the tool's speed, and of the sum of joint speeds, are looked at where a robot is sampled.

Between two rows a joint moves on a cubic in time: its speed is a parabola, its acceleration a straight
line, its jerk constant. So rows settle all three, at every moment, and whether they fit each other.

Joint limits and joint speeds of what was executed, against those of the URDF.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
import numpy.typing as npt

from planning.cell.robot_model import MotionLimits
from planning.cell.workcell import PlacedRobot, Workcell
from planning.transforms import Array
from twin.audit.motion.efforts import RobotEfforts, ToolSpeeds
from twin.audit.motion.executed import Recording, RobotRows
from twin.audit.motion.movers import moving_samples, states_at
from twin.audit.violation import Violation, ViolationKind
from twin.audit.worlds.world import JointLimits


def joint_violations(
    robots: Mapping[str, RobotRows], limits: Mapping[str, JointLimits]
) -> Iterator[Violation]:
    """Yield where a joint leaves its range or moves faster than it may.

    Between two rows a robot moves along a straight line in joint space, so rows settle both.

    Args:
        robots: what was executed.
        limits: of each robot.
    """
    for name, rows in robots.items():
        yield from _out_of_range(name, rows, limits[name])
        yield from _too_fast(name, rows, limits[name])


def _out_of_range(
    robot: str, rows: RobotRows, limits: JointLimits
) -> Iterator[Violation]:
    beyond = np.maximum(rows.q - limits.upper, limits.lower - rows.q)
    for joint, where in runs(beyond > _BEYOND):
        worst = where[np.argmax(beyond[where, joint])]
        above = rows.q[worst, joint] > limits.upper[joint]
        limit = (limits.upper if above else limits.lower)[joint]
        unit = limits.units[joint]
        yield Violation(
            float(rows.t[where[0]]),
            float(rows.t[where[-1]]),
            robot,
            limits.names[joint],
            0.0,
            f"{_against(rows.q[worst, joint], limit, unit)}, node {rows.node[worst]}",
            "joint-limit",
        )


def _too_fast(robot: str, rows: RobotRows, limits: JointLimits) -> Iterator[Violation]:
    seconds, way = np.diff(rows.t)[:, None], np.abs(np.diff(rows.q, axis=0))
    share = way / (limits.velocity * (seconds * (1.0 + _BEYOND) + _TICKS))
    speed = way / np.maximum(seconds, _TICKS)
    for joint, where in runs(share > 1.0):
        worst = where[np.argmax(share[where, joint])]
        limit, unit = limits.velocity[joint], f"{limits.units[joint]}/s"
        most = _against(speed[worst, joint], limit, unit)
        yield Violation(
            float(rows.t[where[0]]),
            float(rows.t[where[-1] + 1]),
            robot,
            limits.names[joint],
            0.0,
            f"{most}, node {rows.node[worst + 1]}",
            "joint-speed",
        )


def _against(value: float, limit: float, unit: str) -> str:
    """Return what there was and the limit of it in words, in as many digits as tell them apart."""
    digits = next((d for d in range(6, 17) if f"{value:.{d}g}" != f"{limit:.{d}g}"), 17)
    return f"{value:.{digits}g} {unit}, its limit is {limit:.{digits}g} {unit}"


def runs(bad: npt.NDArray[np.bool_]) -> Iterator[tuple[int, npt.NDArray[np.intp]]]:
    """Yield each column with each run of consecutive rows that are True in it."""
    for column in np.flatnonzero(bad.any(axis=0)).tolist():
        rows = np.flatnonzero(bad[:, column])
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
            yield column, run


_BEYOND = 1e-6
"""Joint values and shares of limits may be this far beyond: rounding [rad, m or 1]."""

_TICKS = 2e-9
"""Times are whole nanoseconds, so a step may seem this much shorter than it is [s]."""

_TICK = 1e-9
"""A row, and what was commanded, are told at whole nanoseconds: together so much too early or late [s]."""

_STEP = 3e-7
"""Share of an acceleration that rounding may make up: it is a difference over a short lag."""

_DIGITS = float(np.finfo(np.float64).eps)
"""Distance of a number from the next one, as a share of it."""

_EFFORT = 1e-4
"""Share of an effort by which it may be exceeded."""

_SPEED, _WAY = 1e-7, 1e-8
"""Rounding of speeds and of ways: what nearly stands is written as standing [rad/s, rad]."""


def limit_violations(cell: Workcell, recording: Recording) -> Iterator[Violation]:
    """Yield where a robot that is to keep to limits does not.

    Args:
        cell: says which robots have limits, and which.
        recording: what was executed.
    """
    for robot in cell.robots:
        rows = recording.robots[robot.name]
        if robot.limits is None or len(rows.t) < 2:
            continue
        if rows.v is None or rows.a is None:
            at = float(rows.t[0]), float(rows.t[-1])
            what = "has limits, and its table neither speeds nor accelerations"
            yield Violation(*at, robot.name, "", 0.0, what, "joint-motion")
            continue
        names = robot.model.joint_names
        units = ["m" if slides else "rad" for slides in robot.model.chain.prismatic]
        yield from _sum_violations(robot, rows)
        for kind, unit, share, told in _shares(rows, rows.v, rows.a, robot.limits):
            for joint, where in runs(share > 1.0):
                worst = where[np.argmax(share[where, joint])]
                most = "speeds and accelerations are not those of the positions"
                if told is not None:
                    value, limit = told[0][worst, joint], told[1][joint]
                    most = _against(value, limit, f"{units[joint]}{unit}")
                yield Violation(
                    float(rows.t[where[0]]),
                    float(rows.t[where[-1] + 1]),
                    robot.name,
                    names[joint],
                    0.0,
                    f"{most}, node {rows.node[worst + 1]}",
                    kind,
                )


def _sum_violations(robot: PlacedRobot, rows: RobotRows) -> Iterator[Violation]:
    """Yield where the speeds of all joints add up to more than they may, at samples."""
    assert robot.limits is not None
    limit = robot.limits.sum_of_speeds
    if np.isinf(limit):
        return
    t = moving_samples(rows, float(rows.t[0]), float(rows.t[-1]))
    speed = np.abs(states_at(rows, t)[1]).sum(axis=1)
    what = "rad/s", " for all joint speeds added up"
    yield from _seen(robot.name, "all joints", t, (speed, limit), what, "joint-speed")


def tool_speed_violations(
    speeds: Iterable[ToolSpeeds],
) -> Iterator[Violation]:
    """Yield where a tool was faster than it may be.

    Args:
        speeds: of the tools for which that is limited.
    """
    for own in speeds:
        what = "m/s", f" with {'a part' if own.loaded else 'nothing'} in hand"
        told = own.speed, own.limit
        yield from _seen(own.robot, "tool", own.t, told, what, "tool-speed")


def _seen(
    robot: str,
    second: str,
    t: Array,
    told: tuple[Array, float],
    what: tuple[str, str],
    kind: ViolationKind,
) -> Iterator[Violation]:
    """Yield where samples are beyond a limit, one violation from where it begins to where it ends."""
    (values, limit), (unit, words) = told, what
    for _, where in runs(values[:, None] > limit * (1.0 + _BEYOND)):
        most = _against(float(np.max(values[where])), limit, unit) + words
        times = float(t[where[0]]), float(t[where[-1]])
        yield Violation(*times, robot, second, 0.0, most, kind)


def _shares(
    rows: RobotRows, v: Array, a: Array, limits: MotionLimits
) -> Iterator[tuple[ViolationKind, str, Array, tuple[Array, Array] | None]]:
    """Yield of what is limited its unit, shares of it step by step, and its values and limits.

    A share of more than 1 is a violation; what steps must fit has no limit that could be named.
    """
    span = np.diff(rows.t)[:, None]
    begin, end = a[:-1], a[1:]
    steepest = np.maximum(np.abs(begin), np.abs(end))
    jerk = np.abs(end - begin) / span
    off = _off(rows, v, jerk, limits)
    either = 0.5 * (off[:-1] + off[1:])
    fastest = _fastest(v, begin, end, span, either)
    rise = np.diff(v, axis=0) - 0.5 * span * (begin + end)
    # A way that is told a nanosecond late is made up for within its step.
    slip = fastest * _TICKS
    room = steepest * (_TICKS + _STEP * span) + either * span + _SPEED
    misfit = np.abs(rise) / (room + slip / span)
    way = np.diff(rows.q, axis=0) - 0.5 * span * (v[:-1] + v[1:])
    way += span * span * (end - begin) / 12.0
    room = slip + (steepest * _STEP * span + either * span + _SPEED) * span + _WAY
    misfit = np.maximum(misfit, np.abs(way) / room)
    yield "joint-motion", "", misfit, None
    room = limits.velocity * (1.0 + _BEYOND) + steepest * _TICKS
    yield "joint-speed", "/s", fastest / room, (fastest, limits.velocity)
    room = limits.acceleration * (1.0 + _BEYOND) + np.maximum(off[:-1], off[1:])
    told = steepest, limits.acceleration
    yield "joint-acceleration", "/s^2", steepest / room, told
    # Steps of nanoseconds say little of jerk but for the rounding of accelerations.
    room = limits.jerk * (span * (1.0 + _BEYOND) + _TICKS)
    room = room + limits.acceleration * _BEYOND + 2.0 * either
    yield "joint-jerk", "/s^3", jerk * span / room, (jerk, limits.jerk)


def _off(rows: RobotRows, v: Array, jerk: Array, limits: MotionLimits) -> Array:
    """Return by how much rounding may put off the acceleration of each row, shape (rows, n).

    What is told of a row may be of ``_TICK`` before or after, which the jerks of the steps near it make
    something of. Besides, an acceleration is a difference of speeds or the second one of positions,
    over a step beside its row: the longer one, as otherwise it would not fit that. Four numbers, each
    off by two digits at most, make a second difference; two make a first.
    """
    span = np.diff(rows.t)[:, None]
    longer = np.maximum(np.vstack([span[:1], span]), np.vstack([span, span[-1:]]))
    near = np.pad(np.minimum(jerk, limits.jerk), ((2, 2), (0, 0)))
    steepest = np.max([near[k : k + len(rows.t)] for k in range(4)], axis=0)
    digits = 8.0 * np.abs(rows.q) / longer + 4.0 * np.abs(v)
    return np.asarray(steepest * _TICK + _DIGITS * digits / longer)


def _fastest(v: Array, begin: Array, end: Array, span: Array, off: Array) -> Array:
    """Return the greatest speed of each step, where its parabola turns if it does, shape (m, n).

    It turns where rounding of accelerations alone, ``off``, makes it turn, by half of that over the step.
    """
    fastest = np.maximum(np.abs(v[:-1]), np.abs(v[1:]))
    turns = begin * end < 0.0
    change = np.where(turns, end - begin, 1.0)
    peak = np.abs(v[:-1] - 0.5 * span * begin * begin / change)
    return np.where(turns, np.maximum(fastest, peak - 0.5 * span * off), fastest)


def effort_violations(
    cell: Workcell,
    recording: Recording,
    efforts: Mapping[str, RobotEfforts],
) -> Iterator[Violation]:
    """Yield where a joint needed more than it can exert though gravity alone leaves it something.

    Args:
        cell: names the joints.
        recording: what was executed.
        efforts: of the robots of which they are known.
    """
    for robot, own in efforts.items():
        rows, model = recording.robots[robot], cell.robot(robot).model
        step = np.searchsorted(rows.t, own.t, side="right") - 1
        step = np.clip(step, 0, len(rows.t) - 2)
        share = np.abs(own.effort) / own.limit
        for joint, where in runs((share > 1.0 + _EFFORT) & own.borne):
            worst = where[np.argmax(share[where, joint])]
            unit = "N" if model.chain.prismatic[joint] else "N m"
            yield Violation(
                float(own.t[where[0]]),
                float(own.t[where[-1]]),
                robot,
                model.joint_names[joint],
                0.0,
                f"{_against(abs(own.effort[worst, joint]), own.limit[joint], unit)},"
                f" node {rows.node[step[worst] + 1]}",
                "joint-effort",
            )
