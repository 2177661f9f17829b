"""Recorded motion, read back from ``trajectory.parquet`` and ``objects.parquet`` alone.

Shapes on their way through a stretch of a run, and those that a robot moves, all at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planning.cell.workcell import Workcell
from planning.errors import OutputError
from planning.tasks.task import GONE
from planning.transforms import Array, Indices, Transform, from_quat_wxyz
from twin.audit.motion.reach import RobotSamples, motion_bounds
from twin.audit.worlds.world import JointAxes, WatchedShape

WORLD = "world"


@dataclass(frozen=True)
class RobotRows:
    """The rows of one robot: straight lines in joint space join them, or cubics in time.

    Attributes:
        t: times, shape (k,), never falling [s].
        q: configurations, shape (k, n).
        node: node of each row, shape (k,), -1 before the first.
        v: joint speeds, shape (k, n), in a run whose robots keep to limits of acceleration; the
            motion between two rows is the cubic of time that has them at both.
        a: accelerations, likewise.
    """

    t: Array
    q: Array
    node: Indices
    v: Array | None = None
    a: Array | None = None

    def at(self, times: Array) -> Array:
        """Return configurations at some times, shape (m, n)."""
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

    def nodes_at(self, t: float) -> Indices:
        """Return the nodes at a time [s]: two where one ends, and while the robot stands."""
        low = int(np.searchsorted(self.t, t, side="left"))
        high = int(np.searchsorted(self.t, t, side="right"))
        if low < high:
            return self.node[low : high + 1]
        before, after = max(low - 1, 0), min(low, len(self.t) - 1)
        stands = np.array_equal(self.q[before], self.q[after])
        return self.node[[before, after] if stands else [after]]


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
    """

    robots: Mapping[str, RobotRows]
    objects: tuple[ObjectRow, ...]
    end: float


def read_recording(folder: Path, cell: Workcell) -> Recording:
    """Read the tables of a run.

    Args:
        folder: of the run.
        cell: names robots and objects; a robot without rows stands at HOME.

    Raises:
        OutputError: a table is missing, or does not fit the cell.
    """
    moves = _read(folder / "trajectory.parquet")
    names = np.asarray(moves["robot"])
    known = {robot.name for robot in cell.robots}
    _reject(folder, set(names.tolist()) - known, "robot", known)
    robots = {}
    for robot in cell.robots:
        mine = names == robot.name
        t = np.asarray(moves["t_s"], dtype=float)[mine]
        if not len(t):
            robots[robot.name] = RobotRows(
                np.zeros(1), robot.home[None, :], np.full(1, -1)
            )
            continue
        names_of = {
            kind: [f"{kind}_{j}" for j in range(robot.model.dof)] for kind in "qva"
        }
        values = {
            kind: np.stack(
                [np.asarray(moves[c], dtype=float)[mine] for c in own], axis=1
            )
            for kind, own in names_of.items()
            if kind == "q" or "v_0" in moves
        }
        node = np.asarray(moves["node"], dtype=np.int64)[mine]
        for kind, given in values.items():
            _check_rows(folder, robot.name, t, given, jumps=kind != "q")
        q = values.pop("q")
        robots[robot.name] = RobotRows(t, q, node, **values)
    table = _read(folder / "objects.parquet")
    boxes = {box.name for box in cell.objects}
    _reject(folder, set(table["object"]) - boxes, "object", boxes)
    rows = []
    for t_s, name, parent, xyz, quat in zip(
        *(table[c] for c in ("t_s", "object", "parent", "xyz", "quat_wxyz")),
        strict=True,
    ):
        holder = None if parent == WORLD else str(parent).rpartition("/")[0]
        if parent == GONE:
            holder = GONE
        elif holder is not None:
            _reject(folder, {holder} - known, "robot", known)
        rows.append(ObjectRow(t_s, name, holder, from_quat_wxyz(xyz, quat)))
    rows.sort(key=lambda row: row.t)
    ends = [float(r.t[-1]) for r in robots.values()]
    end = max(*ends, *(row.t for row in rows))
    return Recording(robots, tuple(rows), end)


def _read(path: Path) -> dict[str, Any]:
    import pyarrow
    import pyarrow.parquet

    try:
        table = pyarrow.parquet.read_table(path)
    except (OSError, pyarrow.ArrowException) as error:
        raise OutputError(f"cannot read {path}: {error}") from error
    return {name: table.column(name).to_pylist() for name in table.column_names}


def _reject(folder: Path, unknown: set[str], what: str, known: set[str]) -> None:
    if unknown:
        raise OutputError(
            f"{folder}: the recording has an unknown {what} {sorted(unknown)[0]!r}",
            choices=tuple(sorted(known)),
        )


def _check_rows(folder: Path, robot: str, t: Array, q: Array, *, jumps: bool) -> None:
    if not np.all(np.isfinite(q)) or np.any(np.diff(t) < 0):
        raise OutputError(
            f"{folder}: rows of robot {robot!r} are incomplete or unordered"
        )
    jump = (np.diff(t) == 0) & np.any(np.abs(np.diff(q, axis=0)) > 1e-9, axis=1)
    if np.any(jump) and not jumps:
        raise OutputError(f"{folder}: robot {robot!r} jumps at {t[:-1][jump][0]:.6f} s")


@dataclass(frozen=True, eq=False)
class Track:
    """A shape during a stretch of m samples.

    Attributes:
        shape: the shape.
        holder: index of the robot that moves it, None for a box at rest.
        link: index of the link it moves with, 0 for the base.
        rotation: shape (m, 3, 3), or (1, 3, 3) at rest.
        centre: of the sphere and the box around it, shape (m, 3), or (1, 3) at rest [m].
        turn: rotation of the box around it, shaped as ``rotation``.
        reach: half edges of the upright box around that box, shaped as ``centre`` [m].
        moved: how far any point of it gets at most from sample to sample, as seen from the base
            and each moved link up to its own, shape (m - 1, link + 1); empty at rest [m].
        at: its pose, where it is at rest.
    """

    shape: WatchedShape
    holder: int | None
    link: int
    rotation: Array
    centre: Array
    turn: Array
    reach: Array
    moved: Array
    at: Transform | None = None

    @property
    def steps(self) -> Array:
        """How far any point of it gets in the world, step by step, shape (m - 1,) [m]."""
        return np.asarray(self.moved[:, 0])

    def pose(self, sample: int) -> Transform:
        """Return its pose at a sample."""
        if self.at is not None:
            return self.at
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = self.rotation[sample], self.centre[sample]
        return out


@dataclass(frozen=True)
class MovedShapes:
    """All that one robot moves: its own shapes, then the objects that it holds.

    Attributes:
        robot: its index.
        shapes: s of them.
        links: that they move with, 0 for the base, shape (s,).
        poses: of the shapes in the frames of their links; None for the robot's own.
        centre: of the spheres and boxes around them, in those frames, shape (s, 3) [m].
        turn: rotations of the boxes, shape (s, 3, 3).
        half: half edges of the boxes, shape (s, 3) [m].
        radius: of the spheres, shape (s,) [m].
    """

    robot: int
    shapes: tuple[WatchedShape, ...]
    links: Indices
    poses: tuple[Transform | None, ...]
    centre: Array
    turn: Array
    half: Array
    radius: Array

    def centres(self, samples: RobotSamples) -> Array:
        """Return where the centres are at m samples, shape (m, s, 3)."""
        turned = np.einsum("msij,sj->msi", samples.rotation[:, self.links], self.centre)
        return np.asarray(turned + samples.position[:, self.links])

    def tracks(
        self, samples: RobotSamples, centre: Array, moved: Array
    ) -> Iterator[Track]:
        """Yield the tracks of all shapes.

        Args:
            samples: m configurations of the robot.
            centre: see ``centres``.
            moved: see ``motion_bounds``.
        """
        turn = samples.rotation[:, self.links] @ self.turn
        reach = np.einsum("msij,sj->msi", np.abs(turn), self.half)
        for k, shape in enumerate(self.shapes):
            link, pose = int(self.links[k]), self.poses[k]
            rotation = samples.rotation[:, link]
            yield Track(
                shape,
                self.robot,
                link,
                rotation if pose is None else rotation @ pose[:3, :3],
                centre[:, k],
                turn[:, k],
                reach[:, k],
                moved[:, k, : link + 1],
            )


def carried(
    robot: int,
    own: Sequence[WatchedShape],
    held: Sequence[tuple[WatchedShape, Transform]],
    hand: int,
) -> MovedShapes:
    """Return what a robot moves.

    Args:
        robot: its index.
        own: its shapes.
        held: the objects that it holds, each with its pose in the frame of the hand.
        hand: index of the link that they move with.
    """
    loads = [(shape, hand, pose) for shape, pose in held]
    bodies = [*((s, s.joint + 1, None) for s in own), *loads]
    turns = [s.turn if p is None else p[:3, :3] @ s.turn for s, _, p in bodies]
    centres = [s.centre if p is None else p[:3, 3] for s, _, p in bodies]
    return MovedShapes(
        robot,
        tuple(shape for shape, _, _ in bodies),
        np.array([link for _, link, _ in bodies], dtype=np.int64),
        tuple(pose for _, _, pose in bodies),
        np.array(centres).reshape(-1, 3),
        np.array(turns).reshape(-1, 3, 3),
        np.array([s.half for s, _, _ in bodies]).reshape(-1, 3),
        np.array([s.radius for s, _, _ in bodies]),
    )


@dataclass(frozen=True)
class Sampled:
    """All that one robot moves, at m samples.

    Attributes:
        what: the shapes.
        samples: configurations of the robot.
        centre: of the shapes, shape (m, s, 3) [m].
        bounds: of their motion, see ``motion_bounds``, shape (m - 1, s, n + 1) [m].
    """

    what: MovedShapes
    samples: RobotSamples
    centre: Array
    bounds: Array

    @property
    def steps(self) -> Array:
        """How far any point of any shape gets, step by step, shape (m - 1,) [m]."""
        return np.asarray(self.bounds[:, :, 0].max(axis=1, initial=0.0))

    def tracks(self) -> list[Track]:
        """Return the tracks of all shapes."""
        return list(self.what.tracks(self.samples, self.centre, self.bounds))


def sampled(axes: JointAxes, what: MovedShapes, samples: RobotSamples) -> Sampled:
    """Return what a robot moves at some samples, and how far it gets between them."""
    centre = what.centres(samples)
    bounds = motion_bounds(axes, samples, what.links, centre, what.radius)
    return Sampled(what, samples, centre, bounds)
