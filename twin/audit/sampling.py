"""Stretches of a run in which nobody takes or leaves an object, sampled finely enough."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planning.errors import OutputError
from planning.transforms import Array, Transform
from twin.audit.executed import ObjectRow, Recording
from twin.audit.reach import RobotSamples, motion_bounds
from twin.audit.worlds.world import AuditWorld, Shape

STEP = 0.01
"""No point of a robot or of what it carries moves further than this between samples [m].

That bounds the whole motion in between, see ``twin.audit.reach``, not only where it begins and ends.
"""

_JOINT_STEP = 0.1
_ROWS = 1500


@dataclass(frozen=True)
class Track:
    """A shape during a stretch of m samples.

    Attributes:
        shape: the shape.
        holder: index of the robot that moves it, None for a box at rest.
        link: index of the link it moves with, 0 for the base.
        rotation: shape (m, 3, 3), or (1, 3, 3) at rest.
        centre: of the sphere around it, shape (m, 3), or (1, 3) at rest [m].
        moved: how far any point of it gets at most from sample to sample, as seen from the base
            and each moved link up to its own, shape (m - 1, link + 1); empty at rest [m].
        size: edge lengths of a box at rest, None for others.
    """

    shape: Shape
    holder: int | None
    link: int
    rotation: Array
    centre: Array
    moved: Array
    size: Array | None = None

    @property
    def steps(self) -> Array:
        """How far any point of it gets in the world, step by step, shape (m - 1,) [m]."""
        return np.asarray(self.moved[:, 0])

    def pose(self, sample: int) -> Transform:
        """Return its pose at a sample."""
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = self.rotation[sample], self.centre[sample]
        return out


@dataclass(frozen=True)
class Stretch:
    """A piece of a run.

    Attributes:
        t: times of the samples, shape (m,), the ends included [s].
        robots: in the order of the cell.
        placements: where every object is that is there: held, or at rest.
        moving: tracks of the shapes of all robots, then of the objects that they hold.
        resting: tracks of the fixtures, then of the objects at rest.
    """

    t: Array
    robots: tuple[RobotSamples, ...]
    placements: Mapping[str, ObjectRow]
    moving: tuple[Track, ...]
    resting: tuple[Track, ...]


def stretches(world: AuditWorld, recording: Recording) -> Iterator[Stretch]:
    """Yield the whole run in order; each stretch starts when the one before it ends."""
    placements = {
        box.name: ObjectRow(0.0, box.name, None, box.start)
        for box in world.cell.objects
        if not box.later
    }
    rows = list(recording.objects)
    times = np.array([0.0, *(row.t for row in rows)])
    passed = [robot.t for robot in recording.robots.values()]
    knots = np.unique(np.concatenate([times, *passed]))
    knots = knots[(knots >= 0.0) & (knots <= recording.end)]
    changes = sorted({row.t for row in rows if 0.0 < row.t <= recording.end})
    # What changes hands at the very end is seen in a last stretch of one moment.
    bounds = [0.0, *changes, recording.end]
    for start, end in pairwise(bounds):
        while rows and rows[0].t <= start:
            row = rows.pop(0)
            placements[row.object] = row
        inside = knots[(knots >= start) & (knots <= end)]
        for k in range(0, max(len(inside) - 1, 1), _ROWS):
            piece = inside[k : k + _ROWS + 1]
            yield _sample(world, recording, piece, dict(placements))


def _sample(
    world: AuditWorld,
    recording: Recording,
    knots: Array,
    placements: Mapping[str, ObjectRow],
) -> Stretch:
    names = [robot.name for robot in world.cell.robots]
    wide = np.zeros(len(knots) - 1)
    for name in names:
        step = np.abs(np.diff(recording.robots[name].at(knots), axis=0))
        wide = np.maximum(wide, step.max(axis=1, initial=0.0) / _JOINT_STEP)
    t = _split(knots, np.ceil(wide))
    for _ in range(6):
        robots = tuple(
            _frames(world, index, recording.robots[name].at(t))
            for index, name in enumerate(names)
        )
        moving, resting = _tracks(world, robots, placements)
        still = np.zeros(len(t) - 1)
        moved = np.max([still, *(track.steps for track in moving)], axis=0)
        if np.all(moved <= STEP):
            return Stretch(t, robots, placements, moving, resting)
        finer = _split(t, np.ceil(moved * 1.02 / STEP))
        if len(finer) == len(t):
            break
        t = finer
    raise OutputError(f"robots move too fast to be sampled near {t[0]:.6f} s")


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


def _frames(world: AuditWorld, index: int, q: Array) -> RobotSamples:
    changed = np.any(np.diff(q, axis=0) != 0.0, axis=1)
    distinct = np.concatenate([[0], np.cumsum(changed)]).astype(np.int64)
    first = np.concatenate([[True], changed])
    rotation, position = world.link_frames(index, q[first])
    return RobotSamples(q, distinct, rotation[distinct], position[distinct])


def _tracks(
    world: AuditWorld,
    robots: tuple[RobotSamples, ...],
    placements: Mapping[str, ObjectRow],
) -> tuple[tuple[Track, ...], tuple[Track, ...]]:
    """Return the tracks of shapes moved by robots, and of those at rest."""
    moving = []
    for shape in world.robot_shapes:
        assert shape.robot is not None
        samples, link = robots[shape.robot], shape.joint + 1
        rotation = samples.rotation[:, link]
        centre = rotation @ shape.centre + samples.position[:, link]
        moved = motion_bounds(
            world.axes[shape.robot], samples, link, centre, shape.radius
        )
        moving.append(Track(shape, shape.robot, link, rotation, centre, moved))
    still = np.zeros((0, 1))
    resting = [
        Track(s, None, 0, f.pose[None, :3, :3], f.pose[None, :3, 3], still, f.size)
        for s, f in zip(world.fixtures, world.cell.fixtures, strict=True)
    ]
    numbers = {robot.name: k for k, robot in enumerate(world.cell.robots)}
    for shape, box in zip(world.objects, world.cell.objects, strict=True):
        placement = placements.get(box.name)
        if placement is None:
            continue
        local = placement.pose
        if placement.holder is None:
            rotation, centre = local[None, :3, :3], local[None, :3, 3]
            resting.append(Track(shape, None, 0, rotation, centre, still, box.size))
        else:
            index = numbers[placement.holder]
            local = world.cell.robots[index].model.flange @ local
            hand, there = robots[index].rotation[:, -1], robots[index].position[:, -1]
            rotation, centre = hand @ local[:3, :3], hand @ local[:3, 3] + there
            link = robots[index].position.shape[1] - 1
            samples = robots[index]
            moved = motion_bounds(
                world.axes[index], samples, link, centre, shape.radius
            )
            moving.append(Track(shape, index, link, rotation, centre, moved))
    return tuple(moving), tuple(resting)
