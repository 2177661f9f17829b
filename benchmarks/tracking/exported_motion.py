"""Reads exported joint trajectories as a stranger does: what each robot is to do when.

Between points, configurations are interpolated as controllers of ROS 2 do: by quintic polynomials
where points have velocities and accelerations, straight where they have positions only. Between
segments a robot holds its last position.
"""

import json
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planning.transforms import Array

States = tuple[Array, Array, Array]
"""Configurations, speeds and accelerations, each of shape (times, joints)."""

_SAME = 1e-6
"""What positions, and speeds, of one instant may differ by in a file [rad, m, rad/s, m/s]."""


@dataclass(frozen=True)
class Handling:
    """A part changes hands.

    Attributes:
        time_s: when [s].
        part: its name.
        holder: the robot that has it from then on, None when it is put down.
    """

    time_s: float
    part: str
    holder: str | None


@dataclass(frozen=True, eq=False)
class Reference:
    """What one robot is told to do.

    Attributes:
        joints: names of its joints.
        time_s: of all points, ascending, shape (points,) [s].
        q: configurations there, shape (points, joints) [rad or m].
        v, a: speeds and accelerations there; None where the file has none.
    """

    joints: tuple[str, ...]
    time_s: Array
    q: Array
    v: Array | None
    a: Array | None

    def states_at(self, times: Array) -> States:
        """Return what is commanded at some times, shape (t,) [s]; it rests before and after."""
        t = np.clip(times, self.time_s[0], self.time_s[-1])
        k = np.searchsorted(self.time_s, t, side="right") - 1
        k = np.clip(k, 0, len(self.time_s) - 2)
        span = (self.time_s[k + 1] - self.time_s[k])[:, None]
        s = t[:, None] - self.time_s[k][:, None]
        if self.v is None or self.a is None:
            speed = (self.q[k + 1] - self.q[k]) / span
            rests = (times < self.time_s[0]) | (times >= self.time_s[-1])
            speed[rests] = 0.0
            return self.q[k] + s * (self.q[k + 1] - self.q[k]) / span, speed, 0 * speed
        return _quintic(
            (self.q[k], self.v[k], self.a[k]),
            (self.q[k + 1], self.v[k + 1], self.a[k + 1]),
            span,
            s,
        )


@dataclass(frozen=True, eq=False)
class ExportedMotion:
    """All that a file of joint trajectories says.

    Attributes:
        robots: references by robot.
        handlings: in the order of time.
        within_limits: whether points have velocities and accelerations.
        end_s: when the last robot is done [s].
    """

    robots: Mapping[str, Reference]
    handlings: tuple[Handling, ...]
    within_limits: bool
    end_s: float


def read_exported_motion(path: Path) -> ExportedMotion:
    """Read the file that ``twin export RUN -f joint-trajectory`` writes.

    Segments start when the file says that their motion began; without velocities, when they start
    if everything takes as long as planned, as their points are timed so.

    Raises:
        ValueError: a segment was not executed, or a robot would have to jump between segments.
    """
    document = json.loads(path.read_text(encoding="utf-8"))
    segments = defaultdict(list)
    for segment in document["segments"]:
        segments[segment["robot"]].append(segment)
    timed = {
        bool(point["velocities"])
        for segment in document["segments"]
        for point in segment["joint_trajectory"]["points"]
    }
    if len(timed) != 1:
        raise ValueError(f"{path}: some points have velocities, others have none")
    within_limits = timed.pop()
    robots = {
        name: _reference(own, within_limits, f"{path}: {name}")
        for name, own in segments.items()
    }
    handlings = [
        Handling(
            _begin(segment, within_limits) + _seconds(item["time_from_start"]),
            item["object"],
            item["holder"],
        )
        for segment in document["segments"]
        for item in segment["handlings"]
    ]
    return ExportedMotion(
        robots,
        tuple(sorted(handlings, key=lambda item: item.time_s)),
        within_limits,
        max(float(reference.time_s[-1]) for reference in robots.values()),
    )


def _reference(
    segments: list[dict[str, Any]], within_limits: bool, where: str
) -> Reference:
    """Put the segments of a robot one after the other."""
    times: list[float] = []
    rows: dict[str, list[list[float]]] = {"positions": []}
    if within_limits:
        rows |= {"velocities": [], "accelerations": []}
    for segment in segments:
        begin = _begin(segment, within_limits)
        for point in segment["joint_trajectory"]["points"]:
            t = begin + _seconds(point["time_from_start"])
            if times and t <= times[-1] + 5e-10:
                _require_same(rows, point, f"{where}, {segment['id']} at {t:.6f} s")
                continue
            times.append(t)
            for key, values in rows.items():
                values.append(point[key])
    q, v, a = (
        np.array(rows[key]) if key in rows else None
        for key in ("positions", "velocities", "accelerations")
    )
    assert q is not None
    joints = tuple(segments[0]["joint_trajectory"]["joint_names"])
    return Reference(joints, np.array(times), q, v, a)


def _require_same(
    rows: Mapping[str, list[list[float]]], point: Mapping[str, Any], where: str
) -> None:
    for key in ("positions", "velocities"):
        if key in rows:
            jump = np.max(np.abs(np.array(rows[key][-1]) - point[key]))
            if jump > _SAME:
                raise ValueError(f"{where}: {key} jump by {jump:g}")


def _begin(segment: Mapping[str, Any], within_limits: bool) -> float:
    span = segment["motion_s" if within_limits else "nominal_s"]
    if span is None or span[0] is None:
        raise ValueError(f"segment {segment['id']} was not executed")
    return float(span[0])


def _seconds(duration: Mapping[str, int]) -> float:
    return duration["sec"] + duration["nanosec"] * 1e-9


def _quintic(begin: States, end: States, span: Array, s: Array) -> States:
    """Return the states after ``s`` of polynomials of degree 5 between states ``span`` apart."""
    q0, v0, a0 = begin
    # What position, speed and acceleration still lack at the end of a parabola from the beginning.
    q = end[0] - (q0 + v0 * span + 0.5 * a0 * span**2)
    v = (end[1] - (v0 + a0 * span)) * span
    a = (end[2] - a0) * span**2
    c3 = (10 * q - 4 * v + 0.5 * a) / span**3
    c4 = (-15 * q + 7 * v - a) / span**4
    c5 = (6 * q - 3 * v + 0.5 * a) / span**5
    return (
        q0 + s * (v0 + s * (0.5 * a0 + s * (c3 + s * (c4 + s * c5)))),
        v0 + s * (a0 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5))),
        a0 + s * (6 * c3 + s * (12 * c4 + s * 20 * c5)),
    )
