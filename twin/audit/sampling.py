"""Stretches of a run in which nobody takes or leaves an object, sampled finely enough."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planning.errors import OutputError
from planning.transforms import Array, Indices, Transform
from twin.audit.bullet_world import AuditWorld, carried_poses, travel
from twin.audit.executed import ObjectRow, Recording

STEP = 0.002
"""No point of a robot or of what it carries moves further than this between samples [m]."""

_JOINT_STEP = 0.05
_ROWS = 1500


@dataclass(frozen=True)
class RobotSamples:
    """A robot during a stretch.

    Attributes:
        q: configurations, shape (m, n).
        distinct: number of the configuration at each sample; it rises when the robot has
            moved, shape (m,).
        rotation: of its base and moved links, shape (m, n + 1, 3, 3).
        position: likewise, shape (m, n + 1, 3) [m].
    """

    q: Array
    distinct: Indices
    rotation: Array
    position: Array


@dataclass(frozen=True)
class Stretch:
    """A piece of a run.

    Attributes:
        t: times of the samples, shape (m,), the ends included [s].
        robots: in the order of the cell.
        placements: where every object is that is there: held, or at rest.
    """

    t: Array
    robots: tuple[RobotSamples, ...]
    placements: Mapping[str, ObjectRow]


def stretches(world: AuditWorld, recording: Recording) -> Iterator[Stretch]:
    """Yield the whole run in order; each stretch starts when the one before it ends."""
    placements = {
        box.name: ObjectRow(0.0, box.name, None, box.start)
        for box in world.cell.objects
        if not box.later
    }
    rows = list(recording.objects)
    knots = np.unique(
        np.concatenate(
            [
                np.zeros(1),
                np.array([row.t for row in rows]),
                *(r.t for r in recording.robots.values()),
            ]
        )
    )
    knots = knots[(knots >= 0.0) & (knots <= recording.end)]
    changes = sorted({row.t for row in rows if 0.0 < row.t <= recording.end})
    # What changes hands at the very end is seen in a last stretch of one moment.
    bounds = [0.0, *changes, recording.end]
    for start, end in pairwise(bounds):
        _apply(placements, rows, start)
        inside = knots[(knots >= start) & (knots <= end)]
        for k in range(0, max(len(inside) - 1, 1), _ROWS):
            piece = inside[k : k + _ROWS + 1]
            yield _sample(world, recording, piece, dict(placements))


def _apply(
    placements: dict[str, ObjectRow], rows: list[ObjectRow], until: float
) -> None:
    while rows and rows[0].t <= until:
        row = rows.pop(0)
        placements[row.object] = row


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
        moved = np.zeros(len(t) - 1)
        for index, samples in enumerate(robots):
            moved = np.maximum(moved, _furthest(world, index, samples, placements))
        if np.all(moved <= STEP):
            return Stretch(t, robots, placements)
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


def _furthest(
    world: AuditWorld,
    index: int,
    samples: RobotSamples,
    placements: Mapping[str, ObjectRow],
) -> Array:
    """Return, step by step, how far any point of a robot or its load gets [m]."""
    moved = np.zeros(len(samples.q) - 1)
    for shape in world.robot_shapes:
        if shape.robot == index and shape.joint >= 0:
            rotation = samples.rotation[:, shape.joint + 1]
            centre = rotation @ shape.centre + samples.position[:, shape.joint + 1]
            moved = np.maximum(moved, travel(rotation, centre, shape.radius))
    for shape in world.objects:
        placement = placements.get(shape.entity)
        if placement and placement.holder == world.cell.robots[index].name:
            rotation, centre = load_frames(world, index, samples, placement.pose)
            moved = np.maximum(moved, travel(rotation, centre, shape.radius))
    return moved


def load_frames(
    world: AuditWorld, index: int, samples: RobotSamples, pose: Transform
) -> tuple[Array, Array]:
    """Return rotations and positions of what a robot holds at ``pose`` in its flange."""
    local = world.cell.robots[index].model.flange @ pose
    return carried_poses(samples.rotation[:, -1], samples.position[:, -1], local)
