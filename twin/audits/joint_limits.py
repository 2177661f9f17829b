"""Audit of joint positions and speeds against the limits of the URDF."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

import numpy as np

from scheduling.witness.robot import JointLimits
from twin.audits.case import Violation
from twin.audits.limit_readings import LIMIT_TOLERANCE, STEP_TOLERANCE_S, LimitReadings
from twin.audits.motion.executed import RobotRows

_TIME_ERROR_S, _WINDOWS_S = 0.01, (0.1, 0.2, 0.4, 0.8)
"""Time error of measured joint positions, and time windows over which their mean speeds are checked [s]."""


def joint_violations(
    robots: Mapping[str, RobotRows],
    limits: Mapping[str, JointLimits],
    measured: Collection[str] = (),
) -> Iterator[Violation]:
    """Yield violations of joint position limits and joint speed limits.

    Between two rows a robot moves along a straight line in joint space, so rows settle both. When a robot
    was where it was measured is known to some milliseconds only, which makes its speed over a few of them
    anything: there it counts how far it came in a step, and in longer and longer times.

    Args:
        robots: executed rows.
        limits: of each robot.
        measured: robots whose rows were measured.
    """
    for robot, rows in robots.items():
        own = limits[robot]
        beyond = np.maximum(rows.q - own.upper, own.lower - rows.q) / LIMIT_TOLERANCE
        nearest = np.where(rows.q > own.upper, own.upper, own.lower)
        readings = LimitReadings(robot, own.names, rows.t, rows.t, rows.node)
        yield from readings.excesses("joint-limit", own.units, beyond, rows.q, nearest)
        units = [f"{u}/s" for u in own.units]
        first, ticks = np.arange(len(rows.t) - 1), STEP_TOLERANCE_S
        spans = [(first, first + 1)]
        if robot in measured:
            ticks = 2.0 * _TIME_ERROR_S
            for window_s in _WINDOWS_S:
                last = np.searchsorted(rows.t, rows.t[first] + window_s)
                there = last < len(rows.t)
                spans.append((first[there], last[there]))
        for begin, end in spans:
            seconds = (rows.t[end] - rows.t[begin])[:, None]
            way = np.abs(rows.q[end] - rows.q[begin])
            share = way / (own.velocity * (seconds * (1.0 + LIMIT_TOLERANCE) + ticks))
            speed = way / np.maximum(seconds, STEP_TOLERANCE_S)
            steps = LimitReadings(
                robot, own.names, rows.t[begin], rows.t[end], rows.node[end]
            )
            found = steps.excesses("joint-speed", units, share, speed, own.velocity)
            yield from found
