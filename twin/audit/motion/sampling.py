"""Stretches of a run in which nobody takes or leaves an object, sampled finely enough."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planning.errors import OutputError
from planning.tasks.task import GONE
from planning.transforms import Array
from twin.audit.motion.executed import (
    MovedShapes,
    ObjectRow,
    Recording,
    Sampled,
    Track,
    carried,
    sampled,
)
from twin.audit.motion.movers import RestingBoxes, StandingTable
from twin.audit.motion.reach import RobotSamples
from twin.audit.worlds.world import AuditWorld, shapes_by_entity

STEP = 0.01
"""No point of a robot or of what it carries moves further than this between samples [m].

That bounds the whole motion in between, see ``twin.audit.motion.reach``, not only where it begins and ends.
"""

_JOINT_STEP = 0.1
"""Most that a joint moves between two samples [rad or m]."""

_ROWS = 1500
"""Rows that are sampled at once: it bounds the memory."""


@dataclass(frozen=True)
class RunStretch:
    """A piece of a run.

    Attributes:
        t: times of the samples, shape (m,), the ends included [s].
        robots: in the order of the cell.
        placements: where every object is that is there: held, or at rest.
        moving: tracks of the shapes of all robots, then of the objects that they hold.
        boxes: the fixtures, then the objects at rest.
    """

    t: Array
    robots: tuple[RobotSamples, ...]
    placements: Mapping[str, ObjectRow]
    moving: tuple[Track, ...]
    boxes: RestingBoxes

    @property
    def resting(self) -> Sequence[Track]:
        """Tracks of the fixtures, then of the objects at rest."""
        return self.boxes.tracks


def stretches(world: AuditWorld, recording: Recording) -> Iterator[RunStretch]:
    """Yield the whole run in order; each stretch starts when the one before it ends."""
    placements = {
        box.name: ObjectRow(0.0, box.name, None, box.start)
        for box in world.cell.objects
        if not box.later
    }
    sampler = _Sampler(world, recording)
    sampler.change(placements.values())
    rows, passed = recording.objects, 0
    moved = [robot.t for robot in recording.robots.values()]
    knots = np.unique(np.concatenate([[0.0], [row.t for row in rows], *moved]))
    knots = knots[(knots >= 0.0) & (knots <= recording.end)]
    changes = sorted({row.t for row in rows if 0.0 < row.t <= recording.end})
    # What changes hands at the very end is seen in a last stretch of one moment.
    bounds = [0.0, *changes, recording.end]
    for start, end in pairwise(bounds):
        first = passed
        while passed < len(rows) and rows[passed].t <= start:
            row = rows[passed]
            placements[row.object] = row
            if row.holder == GONE:
                del placements[row.object]
            passed += 1
        sampler.change(rows[first:passed])
        low, high = np.searchsorted(knots, start), np.searchsorted(knots, end, "right")
        inside = knots[low:high]
        for k in range(0, max(len(inside) - 1, 1), _ROWS):
            piece = inside[k : k + _ROWS + 1]
            yield sampler.sample(piece, dict(placements))


class _Sampler:
    """Samples a recording finely enough, with what is known of a cell's shapes.

    Args:
        world: the cell.
        recording: what was executed.
    """

    def __init__(self, world: AuditWorld, recording: Recording) -> None:
        self._world = world
        self._robots = world.cell.robots
        self._rows = [recording.robots[robot.name] for robot in self._robots]
        self._own = [
            [shape for shape in world.robot_shapes if shape.robot == k]
            for k in range(len(self._robots))
        ]
        self._objects = shapes_by_entity(world.objects)
        self._order = {shape.number: k for k, shape in enumerate(world.objects)}
        self._held: dict[str, ObjectRow] = {}
        self._standing = StandingTable(world)

    def change(self, rows: Iterable[ObjectRow]) -> None:
        """Take over where objects are from now on."""
        for row in rows:
            self._held.pop(row.object, None)
            if row.holder is not None:
                self._held[row.object] = row
            self._standing.put(row)

    def sample(self, knots: Array, placements: Mapping[str, ObjectRow]) -> RunStretch:
        """Return a stretch between knots, in which objects are where they are now."""
        bodies = [self._carried(k) for k in range(len(self._robots))]
        wide = np.zeros(len(knots) - 1)
        for rows in self._rows:
            step = np.abs(np.diff(rows.at(knots), axis=0))
            wide = np.maximum(wide, step.max(axis=1, initial=0.0) / _JOINT_STEP)
        t = _split(knots, np.ceil(wide))
        for _ in range(6):
            found = [
                sampled(self._world.axes[k], bodies[k], self._frames(k, t))
                for k in range(len(self._robots))
            ]
            moved = np.max([np.zeros(len(t) - 1), *(f.steps for f in found)], axis=0)
            if np.all(moved <= STEP):
                samples = tuple(item.samples for item in found)
                boxes = self._standing.boxes()
                return RunStretch(t, samples, placements, self._moving(found), boxes)
            finer = _split(t, np.ceil(moved * 1.02 / STEP))
            if len(finer) == len(t):
                break
            t = finer
        raise OutputError(f"robots move too fast to be sampled near {t[0]:.6f} s")

    def _carried(self, robot: int) -> MovedShapes:
        """Return all that a robot moves now."""
        placed = self._robots[robot]
        flange, hand = placed.model.flange, len(self._world.axes[robot].prismatic)
        held = [
            (shape, shape.at(flange @ row.pose))
            for name, row in self._held.items()
            if row.holder == placed.name
            for shape in self._objects[name]
        ]
        return carried(robot, self._own[robot], held, hand)

    def _frames(self, robot: int, t: Array) -> RobotSamples:
        q = self._rows[robot].at(t)
        changed = np.any(np.diff(q, axis=0) != 0.0, axis=1)
        distinct = np.concatenate([[0], np.cumsum(changed)]).astype(np.int64)
        first = np.concatenate([[True], changed])
        rotation, position = self._world.link_frames(robot, q[first])
        return RobotSamples(q, distinct, rotation[distinct], position[distinct])

    def _moving(self, found: Iterable[Sampled]) -> tuple[Track, ...]:
        """Return the tracks of all robots' shapes, then of the objects they hold, in order."""
        tracks = [track for item in found for track in item.tracks()]
        arms = [track for track in tracks if track.shape.robot is not None]
        loads = [track for track in tracks if track.shape.robot is None]
        loads.sort(key=lambda track: self._order[track.shape.number])
        return (*arms, *loads)


def _split(t: Array, parts: Array) -> Array:
    """Return ``t`` with interval k divided into ``parts[k]`` equal ones (at least one)."""
    count = np.maximum(parts, 1).astype(np.int64)
    interval = np.repeat(np.arange(len(count)), count)
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    share = (np.arange(len(interval)) - first[interval]) / count[interval]
    inner = (
        t[interval] + share * (t[interval + 1] - t[interval]) if len(t) > 1 else t[:0]
    )
    return np.unique(np.append(inner, t[-1]))
