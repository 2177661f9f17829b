"""Joint limits and joint speeds of what was executed, against those of the URDF."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import numpy.typing as npt

from twin.audit.motion.executed import RobotRows
from twin.audit.violation import Violation
from twin.audit.worlds.world import JointLimits

_BEYOND = 1e-6
"""Joint values and shares of speed limits may be this far beyond: rounding [rad, m or 1]."""

_TICKS = 2e-9
"""Times are whole nanoseconds, so a step may seem this much shorter than it is [s]."""


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
            f"{rows.q[worst, joint]:.6g} {unit}, its limit is {limit:.6g} {unit},"
            f" node {rows.node[worst]}",
            "joint-limit",
        )


def _too_fast(robot: str, rows: RobotRows, limits: JointLimits) -> Iterator[Violation]:
    seconds = np.diff(rows.t)[:, None] * (1.0 + _BEYOND) + _TICKS
    share = np.abs(np.diff(rows.q, axis=0)) / (limits.velocity * seconds)
    for joint, where in runs(share > 1.0):
        worst = where[np.argmax(share[where, joint])]
        unit = limits.units[joint]
        yield Violation(
            float(rows.t[where[0]]),
            float(rows.t[where[-1] + 1]),
            robot,
            limits.names[joint],
            0.0,
            f"{share[worst, joint]:.4g} times its limit of"
            f" {limits.velocity[joint]:.6g} {unit}/s, node {rows.node[worst + 1]}",
            "joint-speed",
        )


def runs(bad: npt.NDArray[np.bool_]) -> Iterator[tuple[int, npt.NDArray[np.intp]]]:
    """Yield each column with each run of consecutive rows that are True in it."""
    for column in np.flatnonzero(bad.any(axis=0)).tolist():
        rows = np.flatnonzero(bad[:, column])
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
            yield column, run
