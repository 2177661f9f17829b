"""Audit of motion limits: speeds, accelerations, jerks and efforts of an execution.

Between two rows of the trajectory table, a joint position is a cubic polynomial of time. Speed, acceleration
and jerk are therefore known at every moment, and the audit checks that they are consistent with the positions.
Limits of the tool speed and of the sum of all joint speeds are checked at samples.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from planning.cell.motion_limits import MotionLimits
from planning.transforms import Array
from twin.audits.case import Violation, ViolationKind
from twin.audits.limit_readings import LIMIT_TOLERANCE, STEP_TOLERANCE_S, LimitReadings
from twin.audits.motion.efforts import RobotEfforts, ToolSpeeds
from twin.audits.motion.executed import ReplayedRun, RobotRows

_TICK = 1e-9
"""Rounding of the times of rows and commands to nanoseconds, together [s]."""

_STEP = 3e-7
"""Share of an acceleration that rounding may make up: it is a difference over a short lag."""

_DIGITS = float(np.finfo(np.float64).eps)
"""Distance of a number from the next one, as a share of it."""

_EFFORT = 1e-4
"""Share of an effort by which it may be exceeded."""

_MISFIT = "speeds and accelerations are not those of the positions"

_SPEED, _WAY = 1e-7, 1e-8
"""Rounding of speeds and displacements: near standstill is written as standstill [rad/s, rad]."""


def limit_violations(replay: ReplayedRun) -> Iterator[Violation]:
    """Yield violations of robots with motion limits."""
    for robot in replay.cell.robots:
        rows = replay.robots[robot.name]
        if robot.limits is None or len(rows.t) < 2:
            continue
        if robot.name in replay.measured:
            continue
        if rows.v is None or rows.a is None:
            at = float(rows.t[0]), float(rows.t[-1])
            what = "has limits, and its table neither speeds nor accelerations"
            yield Violation(*at, robot.name, "", 0.0, what, "joint-motion")
            continue
        limit = robot.limits.sum_of_speeds
        if np.isfinite(limit):
            t = rows.moving_samples(float(rows.t[0]), float(rows.t[-1]))
            speed = np.abs(rows.states(t)[1]).sum(axis=1)
            readings = LimitReadings(robot.name, ("all joints",), t, t)
            words = " for all joint speeds added up"
            yield from _seen(readings, "joint-speed", "rad/s", (speed, limit), words)
        slides = robot.model.chain.prismatic
        times = rows.t[:-1], rows.t[1:], rows.node[1:]
        steps = LimitReadings(robot.name, robot.model.joint_names, *times)
        found = _shares(rows, rows.v, rows.a, robot.limits)
        for kind, unit, share, values, limits in found:
            units = [("m" if slide else "rad") + unit for slide in slides]
            words = _MISFIT if kind == "joint-motion" else ""
            yield from steps.excesses(kind, units, share, values, limits, words)


def tool_speed_violations(speeds: Iterable[ToolSpeeds]) -> Iterator[Violation]:
    """Yield violations of tool speed limits.

    Args:
        speeds: of the tools for which that is limited.
    """
    for own in speeds:
        words = f" with {'a part' if own.loaded else 'nothing'} in hand"
        readings = LimitReadings(own.robot, ("tool",), own.t, own.t)
        yield from _seen(readings, "tool-speed", "m/s", (own.speed, own.limit), words)


def _seen(
    readings: LimitReadings,
    kind: ViolationKind,
    unit: str,
    at: tuple[Array, float],
    words: str,
) -> Iterator[Violation]:
    """Yield intervals in which samples of a value exceed a limit."""
    values, limit = at[0][:, None], at[1]
    share = values / (limit * (1.0 + LIMIT_TOLERANCE))
    yield from readings.excesses(kind, (unit,), share, values, limit, words)


def _shares(
    rows: RobotRows, v: Array, a: Array, limits: MotionLimits
) -> Iterator[tuple[ViolationKind, str, Array, Array, Array | float]]:
    """Yield for each limited quantity: unit, ratios to the limit per step, values and limits."""
    span = np.diff(rows.t)[:, None]
    begin, end = a[:-1], a[1:]
    steepest = np.maximum(np.abs(begin), np.abs(end))
    jerk = np.abs(end - begin) / span
    off = _off(rows, v, jerk, limits)
    either = 0.5 * (off[:-1] + off[1:])
    fastest = _fastest(v, begin, end, span, either)
    rise = np.diff(v, axis=0) - 0.5 * span * (begin + end)
    # A position recorded a nanosecond late is compensated within its step.
    slip = fastest * STEP_TOLERANCE_S
    room = steepest * (STEP_TOLERANCE_S + _STEP * span) + either * span + _SPEED
    misfit = np.abs(rise) / (room + slip / span)
    way = np.diff(rows.q, axis=0) - 0.5 * span * (v[:-1] + v[1:])
    way += span * span * (end - begin) / 12.0
    room = slip + (steepest * _STEP * span + either * span + _SPEED) * span + _WAY
    misfit = np.maximum(misfit, np.abs(way) / room)
    yield "joint-motion", "", misfit, misfit, np.inf
    room = limits.velocity * (1.0 + LIMIT_TOLERANCE) + steepest * STEP_TOLERANCE_S
    yield "joint-speed", "/s", fastest / room, fastest, limits.velocity
    room = limits.acceleration * (1.0 + LIMIT_TOLERANCE) + np.maximum(off[:-1], off[1:])
    share = steepest / room
    yield "joint-acceleration", "/s^2", share, steepest, limits.acceleration
    # Jerk in steps of nanoseconds is mostly rounding of accelerations.
    room = limits.jerk * (span * (1.0 + LIMIT_TOLERANCE) + STEP_TOLERANCE_S)
    room = room + limits.acceleration * LIMIT_TOLERANCE + 2.0 * either
    yield "joint-jerk", "/s^3", jerk * span / room, jerk, limits.jerk


def _off(rows: RobotRows, v: Array, jerk: Array, limits: MotionLimits) -> Array:
    """Return the possible rounding error of each row's acceleration, shape (rows, n).

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
    replay: ReplayedRun, efforts: Mapping[str, RobotEfforts]
) -> Iterator[Violation]:
    """Yield violations of effort limits, where gravity alone does not exceed them.

    Args:
        replay: the execution.
        efforts: of the robots of which they are known.
    """
    for robot, own in efforts.items():
        rows, model = replay.robots[robot], replay.cell.robot(robot).model
        step = np.searchsorted(rows.t, own.t, side="right") - 1
        step = np.clip(step, 0, len(rows.t) - 2)
        effort = np.abs(own.effort)
        share = np.where(own.borne, effort / (own.limit * (1.0 + _EFFORT)), 0.0)
        units = ["N" if slides else "N m" for slides in model.chain.prismatic]
        readings = LimitReadings(
            robot, model.joint_names, own.t, own.t, rows.node[step + 1]
        )
        yield from readings.excesses("joint-effort", units, share, effort, own.limit)
