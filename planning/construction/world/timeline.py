"""Timelines: the planned motion of one robot, or the planned poses of one object, over time.

Timelines are divided into pieces. Each piece becomes a node of a temporal plan graph.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.cell.workcell import Attachment
from planning.errors import PlanInvariantError
from planning.transforms import Array, Transform, read_only_copy

SAME = 1e-9
"""Times that differ by less are the same time [s]; likewise joint values [rad or m]."""

Hand = tuple[tuple[str, bytes], ...]
"""Objects held by a robot: names, and poses in the flange frame as bytes."""

HandChange = tuple[float, Hand]
"""From when on a robot holds what [s]."""

STEP = 0.1
"""Length of the cells of time, and of pose nodes [s]."""


@dataclass(frozen=True, eq=False)
class RobotTimeline:
    """The motion of one robot, straight in joint space between waypoints.

    It stands at the first waypoint before the first time and at the last one ever after.

    Attributes:
        robot: its name.
        time: of the waypoints, non-decreasing, shape (w,), w >= 1 [s].
        path: the waypoints, shape (w, n).
        skills: spans of time (start, end) that are one piece of work each: one node of a
            temporal plan graph, so whatever the robot sweeps in one it may sweep at any time
            of it. In order, not overlapping.
        busy_until: end of the robot's work; what comes later is a retreat out of others' way, which
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
        time, path = read_only_copy(self.time), read_only_copy(self.path)
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
        """Return the time span of the skill at time ``t``, ``(t, t)`` where there is none [s]."""
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
            work: False for a retreat out of others' way, see ``busy_until``.

        Raises:
            PlanInvariantError: it does not begin where and when the robot stands.
        """
        if time[0] < self.end - SAME or np.max(np.abs(path[0] - self.path[-1])) > 1e-6:
            raise PlanInvariantError(
                f"robot {self.robot!r} stands at {np.round(self.path[-1], 4).tolist()}"
                f" from {self.end:.3f} s on, and is to continue from"
                f" {np.round(path[0], 4).tolist()} at {time[0]:.3f} s"
            )
        more = np.maximum(np.asarray(time, dtype=np.float64), self.end)
        skills = (*self.skills, (float(more[0]), float(more[-1])))
        return RobotTimeline(
            self.robot,
            np.concatenate([self.time, more]),
            # Not even by a rounding error does it move between two motions.
            np.vstack([self.path, self.path[-1:], path[1:]]),
            skills if skill else self.skills,
            float(more[-1]) if work else self.busy_until,
        )

    def work(self) -> RobotTimeline:
        """Return the timeline up to the end of the work, with a final hold there."""
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
    """Start of a period in which an object is held by a robot, or at rest.

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
        change = ObjectChange(time, holder, read_only_copy(pose))
        return ObjectTimeline(self.object, (*self.changes, change))


def held_objects_over_time(
    objects: Mapping[str, ObjectTimeline],
) -> dict[str, list[HandChange]]:
    """Return the objects held over time by each robot that ever holds any, see ``hand_changes``."""
    spans: dict[str, list[tuple[float, float, str, bytes]]] = {}
    for name, line in objects.items():
        for k, change in enumerate(line.changes):
            if change.holder is not None:
                last = k + 1 == len(line.changes)
                end = np.inf if last else line.changes[k + 1].time
                own = (change.time, end, name, change.pose.tobytes())
                spans.setdefault(change.holder, []).append(own)
    return {robot: _changes(own) for robot, own in spans.items()}


def hand_changes(objects: Mapping[str, ObjectTimeline], robot: str) -> list[HandChange]:
    """Return the objects that a robot holds from each time on, the first from minus infinity."""
    return held_objects_over_time(objects).get(robot) or _changes([])


def _changes(spans: Sequence[tuple[float, float, str, bytes]]) -> list[HandChange]:
    """Return the objects a robot holds from each time on, given the time span and pose of each."""
    times = sorted({t for a, b, _, _ in spans for t in (a, b) if np.isfinite(t)})
    out: list[HandChange] = []
    for t in [-np.inf, *times]:
        hand = tuple((name, pose) for a, b, name, pose in spans if a <= t < b)
        if not out or out[-1][1] != hand:
            out.append((t, hand))
    return out


def decode_pose(hand: bytes) -> Transform:
    """Return a pose from its bytes."""
    return np.frombuffer(hand, dtype=np.float64).reshape(4, 4)


class MotionPieces(NamedTuple):
    """The motion of one robot from a given time on, cut into pieces, in order.

    Attributes:
        start, end: the time for which a piece counts, shape (p,) [s]; the last one may never
            end.
        q_a, q_b: ends of its straight motion, shape (p, n).
        whole: True where it counts as a whole all the time, False where the robot is at a
            definite place at each time, shape (p,).
        moment: when it begins to be carried out, shape (p,) [s]; ``start`` but in skills.
    """

    start: Array
    end: Array
    q_a: Array
    q_b: Array
    whole: npt.NDArray[np.bool_]
    moment: Array

    def later(self, k: int) -> MotionPieces:
        """Return the pieces without the first ``k``."""
        return MotionPieces._make(values[k:] for values in self)


def cut_timeline(
    line: RobotTimeline,
    start: float,
    until: float,
    step: float,
    changes: Sequence[float] = (),
    cuts: Sequence[float] = (),
) -> MotionPieces:
    """Return the pieces of a timeline.

    Args:
        line: the timeline.
        start: pieces that end before are left out [s].
        until: the robot is there up to this time, infinity without an end [s].
        step: cells of time begin at its multiples [s].
        changes: times at which pieces end even where the robot stands, such as those at which
            objects change hands.
        cuts: more times at which motions are cut.
    """
    inside = [span for span in line.skills if span[0] <= start < span[1]]
    begin = min([start, *(span[0] for span in inside)])
    last = min(line.end, until)
    skills = [s for s in line.skills if s[1] > begin and s[0] < until]
    given = np.concatenate([line.time, changes, cuts])
    times = _cut_times(begin, last, step, skills, given)
    q = np.stack([np.interp(times, line.time, column) for column in line.path.T], 1)
    if until > last + SAME:
        # It stands from the end of its timeline on.
        later = sorted(c for c in changes if last + SAME < c < until)
        times = np.concatenate([times, later, [until]])
        q = np.vstack([q, np.tile(q[-1], (len(later) + 1, 1))])
    t_a, t_b = times[:-1].copy(), times[1:].copy()
    whole = np.zeros(len(t_a), dtype=np.bool_)
    for a, b in skills:
        whole |= (t_a >= a - SAME) & (t_b <= b + SAME)
    q_a, q_b = q[:-1], q[1:]
    moves = np.any(q_a != q_b, axis=1) | whole
    # Stands that follow each other are one stand, unless something changes in the hand.
    joined = np.zeros(len(t_a), dtype=np.bool_)
    joined[1:] = ~moves[1:] & ~moves[:-1]
    if len(changes):
        nearest = np.searchsorted(np.sort(changes), t_a - SAME)
        bounds = np.append(np.sort(changes), np.inf)
        joined &= bounds[nearest] > t_a + SAME
    first = np.flatnonzero(~joined)
    stop = np.append(first[1:], len(t_a)) - 1
    moment = t_a[first]
    t_a, t_b = t_a[first], t_b[stop]
    whole = whole[first]
    for a, b in skills:
        own = whole & (t_a >= a - SAME) & (t_b <= b + SAME)
        t_a[own], t_b[own] = a, b
    return MotionPieces(
        t_a,
        t_b,
        np.ascontiguousarray(q_a[first]),
        np.ascontiguousarray(q_b[stop]),
        whole,
        moment,
    )


def _cut_times(
    begin: float,
    last: float,
    step: float,
    skills: Sequence[tuple[float, float]],
    given: Array,
) -> Array:
    """Return the times at which pieces begin and end: of the grid, of skills, and given ones.

    The grid does not cut skills.
    """
    grid = np.arange(np.ceil(begin / step), np.floor(last / step) + 1) * step
    for a, b in skills:
        grid = grid[(grid <= a + SAME) | (grid >= b - SAME)]
    ends = [t for span in skills for t in span]
    times = np.concatenate([[begin], grid, given, ends, [last]])
    times = np.unique(times[(times >= begin) & (times <= max(last, begin))])
    return np.asarray(times[np.concatenate([[True], np.diff(times) > SAME])])
