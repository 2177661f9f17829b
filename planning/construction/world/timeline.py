"""Timelines: the motion of one robot, and the places of one object, as far as planned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from planning.cell.workcell import Attachment
from planning.errors import PlanInvariantError
from planning.transforms import Array, Transform, readonly

SAME = 1e-9
"""Times that differ by less are the same time [s]; likewise joint values [rad or m]."""


@dataclass(frozen=True, eq=False)
class RobotTimeline:
    """The motion of one robot, straight in joint space between waypoints.

    It stands at the first waypoint before the first time and at the last one ever after.

    Attributes:
        robot: its name.
        time: of the waypoints, never falling, shape (w,), w >= 1 [s].
        path: the waypoints, shape (w, n).
        skills: spans of time (start, end) that are one piece of work each: one node of a
            temporal plan graph, so whatever the robot sweeps in one it may sweep at any time
            of it. In order, not overlapping.
        busy_until: end of the robot's work; what comes later is a way out of others' way, which
            may be dropped when there is new work. The last time where not given.
    """

    robot: str
    time: Array
    path: Array
    skills: tuple[tuple[float, float], ...] = ()
    busy_until: float = np.nan

    def __post_init__(self) -> None:
        """Freeze the arrays and fill in ``busy_until``.

        Raises:
            PlanInvariantError: shapes do not fit or times fall.
        """
        time, path = readonly(self.time), readonly(self.path)
        if path.ndim != 2 or len(path) == 0 or time.shape != (len(path),):
            raise PlanInvariantError(
                f"timeline of robot {self.robot!r}: {time.shape} times for a path of"
                f" shape {path.shape}"
            )
        if np.any(np.diff(time) < 0.0):
            raise PlanInvariantError(f"timeline of robot {self.robot!r}: times fall")
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "path", path)
        if np.isnan(self.busy_until):
            object.__setattr__(self, "busy_until", float(time[-1]))

    @property
    def end(self) -> float:
        """End of its last motion [s]."""
        return float(self.time[-1])

    def at(self, t: float) -> Array:
        """Return the configuration at time ``t``, shape (n,)."""
        k = int(np.searchsorted(self.time, t, side="right"))
        if k == 0 or k == len(self.time):
            return np.array(self.path[min(k, len(self.time) - 1)])
        span = self.time[k] - self.time[k - 1]
        share = (t - self.time[k - 1]) / span
        return np.asarray(self.path[k - 1] + share * (self.path[k] - self.path[k - 1]))

    def skill_at(self, t: float) -> tuple[float, float]:
        """Return the span of the skill at time ``t``, ``(t, t)`` where there is none [s]."""
        for a, b in self.skills:
            if a - SAME <= t <= b + SAME:
                return a, b
        return t, t

    def then(
        self, time: Array, path: Array, *, skill: bool = False, work: bool = True
    ) -> RobotTimeline:
        """Return the timeline with more motion after its end.

        Args:
            time: of the waypoints, the first no earlier than the end, shape (w,) [s].
            path: waypoints, the first where the robot stands at the end, shape (w, n).
            skill: the motion is one piece of work.
            work: False for a way out of others' way, see ``busy_until``.

        Raises:
            PlanInvariantError: it does not begin where and when the robot stands.
        """
        if time[0] < self.end - SAME or np.max(np.abs(path[0] - self.path[-1])) > 1e-6:
            raise PlanInvariantError(
                f"robot {self.robot!r} stands at {np.round(self.path[-1], 4).tolist()}"
                f" from {self.end:.3f} s on, and is to go on from"
                f" {np.round(path[0], 4).tolist()} at {time[0]:.3f} s"
            )
        more = np.maximum(np.asarray(time, dtype=np.float64), self.end)
        skills = (*self.skills, (float(more[0]), float(more[-1])))
        return RobotTimeline(
            self.robot,
            np.concatenate([self.time, more]),
            np.vstack([self.path, path]),
            skills if skill else self.skills,
            float(more[-1]) if work else self.busy_until,
        )

    def work(self) -> RobotTimeline:
        """Return the timeline up to the end of the work, where the robot then stands for good."""
        t = self.busy_until
        if t >= self.end:
            return self
        keep = int(np.searchsorted(self.time, t, side="left"))
        return replace(
            self,
            time=np.append(self.time[:keep], t),
            path=np.vstack([self.path[:keep], self.at(t)[None]]),
        )


class ObjectChange(NamedTuple):
    """Beginning of a time for which an object is held by a robot, or at rest.

    Attributes:
        time: when it happens [s].
        holder: a robot's name, None at rest.
        pose: of the object's centre in the holder's flange frame, or in the world.
    """

    time: float
    holder: str | None
    pose: Transform


@dataclass(frozen=True)
class ObjectTimeline:
    """Timeline of one object: its pose and holder from change to change.

    Attributes:
        object: its name.
        changes: in order of time; before the first it is where the cell says it starts.
    """

    object: str
    changes: tuple[ObjectChange, ...] = ()

    def at(self, t: float) -> Attachment | None:
        """Return its attachment at time ``t``, None before the first change."""
        found = None
        for change in self.changes:
            if change.time > t + SAME:
                break
            found = Attachment(change.holder, change.pose)
        return found

    def then(self, time: float, holder: str | None, pose: Transform) -> ObjectTimeline:
        """Return the timeline with one more change.

        Raises:
            PlanInvariantError: it is earlier than the last one.
        """
        if self.changes and time < self.changes[-1].time:
            raise PlanInvariantError(
                f"object {self.object!r} changes hands at {time:.3f} s, before its last"
                f" change at {self.changes[-1].time:.3f} s"
            )
        change = ObjectChange(time, holder, readonly(pose))
        return ObjectTimeline(self.object, (*self.changes, change))


Hand = tuple[tuple[str, bytes], ...]
"""Objects held by a robot: names, and poses in the flange frame as bytes."""

HandChange = tuple[float, Hand]
"""From when on a robot holds what [s]."""


def hand_changes(objects: Mapping[str, ObjectTimeline], robot: str) -> list[HandChange]:
    """Return the objects that a robot holds from each time on, the first from minus infinity."""
    spans: list[tuple[float, float, str, bytes]] = []
    for name, line in objects.items():
        for k, change in enumerate(line.changes):
            if change.holder == robot:
                last = k + 1 == len(line.changes)
                end = np.inf if last else line.changes[k + 1].time
                spans.append((change.time, end, name, change.pose.tobytes()))
    times = sorted({t for a, b, _, _ in spans for t in (a, b) if np.isfinite(t)})
    out: list[HandChange] = []
    for t in [-np.inf, *times]:
        hand = tuple((name, pose) for a, b, name, pose in spans if a <= t < b)
        if not out or out[-1][1] != hand:
            out.append((t, hand))
    return out


def pose_of(hand: bytes) -> Transform:
    """Return a pose from its bytes."""
    return np.frombuffer(hand, dtype=np.float64).reshape(4, 4)
