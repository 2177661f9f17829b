"""Stretches of a run between object transfers, sampled finely enough."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from planning.errors import OutputError
from planning.transforms import Array
from twin.audits.motion.executed import ReplayedRun, Stay
from twin.audits.motion.movers import MovedShapes, Movers, StandingTable, joined_movers
from twin.audits.motion.reach import RobotSamples
from twin.audits.worlds.world import AuditWorld, shapes_by_entity

STEP = 0.01
"""Largest travel of any point of a robot or its load between samples [m].

That bounds the whole motion in between, see ``twin.audits.motion.reach``, not only where it begins and ends.
"""

_JOINT_STEP = 0.1
"""Most that a joint moves between two samples [rad or m]."""

_ROWS = 1500
"""Rows that are sampled at once: it bounds the memory."""


@dataclass(frozen=True)
class RunStretch:
    """A stretch of a run.

    Attributes:
        t: times of the samples, shape (m,), the ends included [s].
        robots: in the order of the cell.
        placements: place of every present object: held, or at rest.
        movers: the shapes of all robots, then of the objects that they hold.
        boxes: the fixtures, then the objects at rest.
    """

    t: Array
    robots: tuple[RobotSamples, ...]
    placements: Mapping[str, Stay]
    movers: Movers
    boxes: Movers


def stretches(world: AuditWorld, replay: ReplayedRun) -> Iterator[RunStretch]:
    """Yield the whole run in order; each stretch starts when the one before it ends."""
    sampler = _Sampler(world, replay)
    moved = [rows.t for rows in replay.robots.values()]
    states = list(replay.states())
    knots = np.unique(np.concatenate([[t for t, _ in states], *moved]))
    knots = knots[(knots >= 0.0) & (knots <= replay.end)]
    ends = [*(t for t, _ in states[1:]), replay.end]
    for (start, placements), end in zip(states, ends, strict=True):
        sampler.standing.change(placements)
        low, high = np.searchsorted(knots, start), np.searchsorted(knots, end, "right")
        inside = knots[low:high]
        for k in range(0, max(len(inside) - 1, 1), _ROWS):
            yield sampler.sample(inside[k : k + _ROWS + 1], placements)


class _Sampler:
    """Samples an execution finely enough, with the shapes of the cell.

    Args:
        world: the cell.
        replay: the execution.

    Attributes:
        standing: table of objects at rest.
    """

    def __init__(self, world: AuditWorld, replay: ReplayedRun) -> None:
        self._world = world
        self._robots = world.cell.robots
        self._rows = [replay.robots[robot.name] for robot in self._robots]
        self._own = [
            [shape for shape in world.robot_shapes if shape.robot == k]
            for k in range(len(self._robots))
        ]
        self._objects = shapes_by_entity(world.objects)
        self._order = {shape.number: k for k, shape in enumerate(world.objects)}
        self.standing = StandingTable(world)

    def sample(self, knots: Array, placements: Mapping[str, Stay]) -> RunStretch:
        """Return a stretch between knots with the current object placements."""
        bodies = [self._carried(k, placements) for k in range(len(self._robots))]
        wide = np.zeros(len(knots) - 1)
        for rows in self._rows:
            step = np.abs(np.diff(rows.at(knots), axis=0))
            wide = np.maximum(wide, step.max(axis=1, initial=0.0) / _JOINT_STEP)
        t = _split(knots, np.ceil(wide))
        for _ in range(6):
            samples = tuple(self._frames(k, t) for k in range(len(self._robots)))
            parts = [
                own.sampled(robot, at)
                for own, robot, at in zip(
                    bodies, self._world.robots, samples, strict=True
                )
            ]
            steps = [part.steps.max(axis=1, initial=0.0) for part in parts]
            moved = np.max([np.zeros(len(t) - 1), *steps], axis=0)
            if np.all(moved <= STEP):
                boxes = self.standing.boxes()
                return RunStretch(t, samples, placements, self._joined(parts), boxes)
            finer = _split(t, np.ceil(moved * 1.02 / STEP))
            if len(finer) == len(t):
                break
            t = finer
        raise OutputError(f"robots move too fast to be sampled near {t[0]:.6f} s")

    def _carried(self, robot: int, placements: Mapping[str, Stay]) -> MovedShapes:
        """Return all shapes that a robot moves now."""
        placed = self._robots[robot]
        flange, hand = placed.model.flange, self._world.robots[robot].dof
        held = [
            (shape, shape.at(flange @ stay.pose))
            for name, stay in placements.items()
            if stay.holder == placed.name
            for shape in self._objects[name]
        ]
        return MovedShapes(robot, self._own[robot], held, hand)

    def _frames(self, robot: int, t: Array) -> RobotSamples:
        q = self._rows[robot].at(t)
        changed = np.any(np.diff(q, axis=0) != 0.0, axis=1)
        distinct = np.concatenate([[0], np.cumsum(changed)]).astype(np.int64)
        first = np.concatenate([[True], changed])
        rotation, position = self._world.link_frames(robot, q[first])
        return RobotSamples(q, distinct, rotation[distinct], position[distinct])

    def _joined(self, parts: Sequence[Movers]) -> Movers:
        """Return all robots' shapes, then those of the objects they hold, in order."""
        shapes = [track.shape for part in parts for track in part.tracks]
        order = sorted(
            range(len(shapes)),
            key=lambda k: (
                -1 if shapes[k].robot is not None else self._order[shapes[k].number]
            ),
        )
        return joined_movers(parts, order)


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
