"""Executed motions and object poses of a run, read from ``trajectory.parquet`` and ``objects.parquet`` only.

``ReplayedRun`` returns the location of each object at any time. All rules of the audit use it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from planning.cell.workcell import PlacedRobot, Workcell
from planning.errors import OutputError
from planning.parquet import read_parquet
from planning.tasks.task import Handling
from planning.transforms import Array, Indices, Transform, from_quat_wxyz

WORLD = "world"

STANDING = 1e-9
"""Joints that move by less than this stand: rounding [rad or m]."""

SETTLING = 5e-3
"""Largest joint displacement of a measured robot at rest, by contact or settling [rad or m]."""

_SAMPLE_S = 0.01
"""So often a robot is looked at, at least, while it moves [s]."""


@dataclass(frozen=True)
class RobotRows:
    """The rows of one robot, joined by straight lines in joint space, or by cubic polynomials in time.

    Attributes:
        t: times, shape (k,), non-decreasing [s].
        q: configurations, shape (k, n).
        node: node of each row, shape (k,), -1 before the first.
        v: joint speeds, shape (k, n), in a run whose robots keep to limits of acceleration; the
            motion between two rows is the cubic of time that has them at both.
        a: accelerations, likewise.
        still: joints that move by less than this stand [rad or m].
    """

    t: Array
    q: Array
    node: Indices
    v: Array | None = None
    a: Array | None = None
    still: float = field(default=STANDING, kw_only=True)

    def at(self, times: Array) -> Array:
        """Return configurations at given times, shape (m, n)."""
        if self.v is not None and len(self.t) > 1:
            return self._cubic_at(self.v, times)
        k = np.clip(np.searchsorted(self.t, times), 1, max(len(self.t) - 1, 1))
        if len(self.t) == 1:
            return np.repeat(self.q, len(times), axis=0)
        span = self.t[k] - self.t[k - 1]
        share = np.divide(
            times - self.t[k - 1], span, out=np.ones_like(times), where=span > 0
        )
        before, after = self.q[k - 1], self.q[k]
        # Written so that a standing robot keeps exactly the same values.
        return np.asarray(before + (after - before) * np.clip(share, 0, 1)[:, None])

    def _cubic_at(self, v: Array, times: Array) -> Array:
        after = np.clip(np.searchsorted(self.t, times), 1, len(self.t) - 1)
        k, span = after - 1, (self.t[after] - self.t[after - 1])[:, None]
        x = np.clip((times[:, None] - self.t[k, None]) / span, 0.0, 1.0)
        begin, way = self.q[k], self.q[after] - self.q[k]
        bend = (v[k] * span - way) * (1.0 - x) + (way - v[after] * span) * x
        # Written so that a standing robot keeps exactly the same values.
        return np.asarray(begin + way * x + x * (1.0 - x) * bend)

    def rows_around(self, times: Array) -> Indices:
        """Return the first row of the nodes at each time, and the row behind the last, shape (m, 2).

        There are two nodes where one ends, and while the robot stands.

        Args:
            times: shape (m,) [s].
        """
        low = np.searchsorted(self.t, times, side="left")
        high = np.searchsorted(self.t, times, side="right")
        before, after = np.maximum(low - 1, 0), np.minimum(low, len(self.t) - 1)
        stands = np.all(self.q[before] == self.q[after], axis=1)
        first = np.where(low < high, low, np.where(stands, before, after))
        last = np.where(low < high, high, after)
        return np.column_stack([first, last + 1])

    def stands(self, begin: float, end: float) -> bool:
        """Return whether the robot stands between two times [s]."""
        inside = self.t[(self.t > begin) & (self.t < end)]
        q = self.at(np.concatenate([[begin], inside, [end]]))
        return bool(np.all(np.abs(q - q[0]) <= self.still))

    def leaves(self, begin: float) -> float:
        """Return when a robot at rest begins to move [s]; infinity if never."""
        here = self.at(np.array([begin]))[0]
        after = np.flatnonzero(self.t > begin)
        moved = np.any(np.abs(self.q[after] - here) > self.still, axis=1)
        if not moved.any():
            return float("inf")
        first = int(after[int(np.argmax(moved))])
        return float(max(self.t[first - 1], begin))

    def moving_samples(
        self, begin: float, end: float, step: float = _SAMPLE_S
    ) -> Array:
        """Return sample times in a span: rows, ends, and more while the robot moves.

        Args:
            begin, end: of the span [s].
            step: longest time between two of them while the robot moves [s].
        """
        low, high = np.searchsorted(self.t, [begin, end])
        knots = np.unique(np.concatenate([[begin], self.t[low:high], [end]]))
        if self.v is None:
            way = np.abs(np.diff(self.at(knots), axis=0))
            moves = np.any(way > STANDING, axis=1)
        else:
            moving = np.any(self.v != 0.0, axis=1)
            k = np.searchsorted(self.t, knots[:-1], side="right")
            last = len(moving) - 1
            moves = moving[np.maximum(k - 1, 0)] | moving[np.minimum(k, last)]
        parts = [knots]
        for a, b in zip(knots[:-1][moves], knots[1:][moves], strict=True):
            count = int(np.ceil((b - a) / step))
            parts.append(np.linspace(a, b, count + 1)[1:-1])
        return np.unique(np.concatenate(parts))

    def states(self, t: Array) -> tuple[Array, Array, Array]:
        """Return configurations, speeds and accelerations at some times, shape (m, n) each.

        Only of a robot whose speeds are known.
        """
        assert self.v is not None
        assert self.a is not None
        k = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 2)
        span, since = (self.t[k + 1] - self.t[k])[:, None], (t - self.t[k])[:, None]
        jerk = (self.a[k + 1] - self.a[k]) / span
        v = self.v[k] + since * (self.a[k] + 0.5 * since * jerk)
        return self.at(t), v, self.a[k] + since * jerk


@dataclass(frozen=True)
class ObjectRow:
    """Place of an object from a time on: held by a robot (flange frame) or at rest (world).

    Attributes:
        t: when [s].
        object: its name.
        holder: the robot, None at rest, GONE once it has left the cell.
        pose: of the object's centre.
    """

    t: float
    object: str
    holder: str | None
    pose: Transform


@dataclass(frozen=True)
class Recording:
    """An execution.

    Attributes:
        robots: the rows of every robot of the cell.
        objects: rows by time.
        end: time of the last row [s].
        measured: robots that others move: their rows were measured, and how they speed up and slow down
            within their limits is their controllers'.
    """

    robots: Mapping[str, RobotRows]
    objects: tuple[ObjectRow, ...]
    end: float
    measured: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class Stay:
    """A stay of an object at one place.

    Attributes:
        object: its name.
        holder: the robot that holds it, None at rest, GONE once it has left the cell.
        pose: of the object's centre, in the holder's flange frame or in the world.
        t: since when; several may be of one moment, of which the last one counts [s].
        until: when the next one begins; infinite for the last one [s].
        giver: robot that held it before, None without one.
    """

    object: str
    holder: str | None
    pose: Transform
    t: float
    until: float
    giver: str | None


class ReplayedRun:
    """The objects of an execution.

    Args:
        cell: the cell, with the poses of objects that are not in the recording.
        recording: the execution.

    Attributes:
        cell: the cell.
        robots: rows of every robot.
        end: time of the last row [s].
        stays: stays of each object in time order.
        in_order: all stays by time.
        measured: see ``Recording``.
    """

    def __init__(self, cell: Workcell, recording: Recording) -> None:
        self.cell, self.robots, self.end = cell, recording.robots, recording.end
        self.measured = recording.measured
        reported = {row.object for row in recording.objects if row.t <= 0.0}
        rows = [
            *(
                ObjectRow(0.0, item.name, None, item.start)
                for item in cell.objects
                if not item.later and item.name not in reported
            ),
            *recording.objects,
        ]
        own: dict[str, list[ObjectRow]] = {item.name: [] for item in cell.objects}
        for row in rows:
            own[row.object].append(row)
        self.stays = {name: tuple(_stays(some)) for name, some in own.items()}
        left = {name: iter(stays) for name, stays in self.stays.items()}
        self.in_order = [next(left[row.object]) for row in rows]

    def handed(self) -> Iterator[Stay]:
        """Yield all stays that begin after the start, by time."""
        return (stay for stay in self.in_order if stay.t > 0.0)

    def states(self, *times: float) -> Iterator[tuple[float, dict[str, Stay]]]:
        """Yield 0, all times of object transfers, and given ones, in order [s].

        With each comes where everything is that is there from then on.
        """
        there: dict[str, Stay] = {}
        left = deque(self.in_order)
        for t in sorted({0.0, *times, *(stay.t for stay in self.handed())}):
            while left and left[0].t <= t:
                stay = left.popleft()
                there[stay.object] = stay
                if stay.holder == Handling.GONE:
                    del there[stay.object]
            yield t, dict(there)

    def place(self, name: str, t: float = np.inf) -> Stay | None:
        """Return the place of an object at a time [s], by default at the end; None if absent."""
        now = [stay for stay in self.stays.get(name, ()) if stay.t <= t]
        return now[-1] if now and now[-1].holder != Handling.GONE else None

    def at(self, t: float = np.inf) -> dict[str, Stay]:
        """Return the places of all present objects at a time [s], by default at the end."""
        places = ((name, self.place(name, t)) for name in self.stays)
        return {name: stay for name, stay in places if stay is not None}

    def held(self, robot: str) -> Iterator[tuple[float, float, list[Stay]]]:
        """Yield spans between transfers [s] with the object that a robot holds in each."""
        ends = self.robots[robot].t[[0, -1]].tolist()
        for (begin, there), (end, _) in pairwise(self.states(*ends)):
            own = [stay for stay in there.values() if stay.holder == robot]
            yield begin, end, own


def _stays(rows: list[ObjectRow]) -> Iterator[Stay]:
    giver = None
    for row, until in zip(rows, [*(row.t for row in rows[1:]), np.inf], strict=False):
        yield Stay(row.object, row.holder, row.pose, row.t, until, giver)
        giver = row.holder


def read_recording(folder: Path, cell: Workcell) -> Recording:
    """Read the tables of a run.

    Args:
        folder: of the run.
        cell: names robots and objects; a robot without rows stands at HOME.

    Raises:
        OutputError: a table is missing, or does not fit the cell.
    """
    known = {robot.name for robot in cell.robots}
    moves = read_parquet(folder / "trajectory.parquet")
    names = moves["robot"].to_numpy()
    _reject(folder, set(names.tolist()) - known, "robot", known)
    measured = (moves.schema.metadata or {}).get(b"measured", b"").decode().split(",")
    robots = {
        robot.name: _rows_of(
            folder,
            robot,
            moves.filter(names == robot.name),
            SETTLING if robot.name in measured else STANDING,
        )
        for robot in cell.robots
    }
    columns = ("t_s", "object", "parent", "xyz", "quat_wxyz")
    table = read_parquet(folder / "objects.parquet").select(columns).to_pylist()
    boxes = {box.name for box in cell.objects}
    _reject(folder, {row["object"] for row in table} - boxes, "object", boxes)
    rows = []
    for t_s, name, parent, *pose in (row.values() for row in table):
        holder = None if parent == WORLD else str(parent).rpartition("/")[0]
        if parent == Handling.GONE:
            holder = Handling.GONE
        elif holder is not None:
            _reject(folder, {holder} - known, "robot", known)
        rows.append(ObjectRow(t_s, name, holder, from_quat_wxyz(*pose)))
    rows.sort(key=lambda row: row.t)
    ends = [float(r.t[-1]) for r in robots.values()]
    end = max((*ends, *(row.t for row in rows)))
    return Recording(robots, tuple(rows), end, frozenset(measured))


def _rows_of(folder: Path, robot: PlacedRobot, table: Any, still: float) -> RobotRows:
    """Return the rows of a robot, as a table of pyarrow has them."""
    if not len(table):
        return RobotRows(np.zeros(1), robot.home[None, :], np.full(1, -1))
    t, node = table["t_s"].to_numpy(), table["node"].to_numpy()
    kinds = "qva" if "v_0" in table.column_names else "q"
    names = [[f"{kind}_{j}" for j in range(robot.model.dof)] for kind in kinds]
    values = [
        np.stack([table[name].to_numpy() for name in own], axis=1) for own in names
    ]
    if not np.all(np.isfinite(values)) or np.any(np.diff(t) < 0):
        raise OutputError(
            f"{folder}: rows of robot {robot.name!r} are incomplete or unordered"
        )
    far = np.any(np.abs(np.diff(values[0], axis=0)) > 1e-9, axis=1)
    jump = (np.diff(t) == 0) & far
    if np.any(jump):
        at = t[:-1][jump][0]
        raise OutputError(f"{folder}: robot {robot.name!r} jumps at {at:.6f} s")
    return RobotRows(t, values[0], node, *values[1:], still=still)


def _reject(folder: Path, unknown: set[str], what: str, known: set[str]) -> None:
    if unknown:
        raise OutputError(
            f"{folder}: the recording has an unknown {what} {sorted(unknown)[0]!r}",
            choices=tuple(sorted(known)),
        )
