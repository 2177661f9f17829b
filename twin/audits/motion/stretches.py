"""Division of a run into time intervals in which no object changes hands, with samples of all robot motions.

No point of a robot or its load moves farther than ``STEP`` between two samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from planning.caches import BoundedCache
from planning.cell.shape import Shape
from planning.errors import OutputError
from planning.transforms import Array, Transform
from scheduling.witness.moving_robot import MovingRobot, StillParts
from scheduling.witness.parts import ConvexPart, resting_parts
from scheduling.witness.robot import WitnessRobot
from twin.audits.motion.executed import ReplayedRun, Stay
from twin.audits.worlds.world import AuditWorld, WatchedShape, shapes_by_entity

STEP = 0.022
"""Bound of the travel of any point of a robot or its load between samples [m]."""

_ROWS = 1500
"""Rows that are sampled at once: it bounds the memory."""

_STANDING = 1000
"""Standing robots, with what they hold, that are kept."""

_Resting = tuple[StillParts, list[tuple[WatchedShape, Transform]]]
"""Objects and fixtures at rest, with the poses of their shapes."""

_ROUNDING = 1.0 + 1e-9
_ATTEMPTS = 6


@dataclass(frozen=True)
class RunStretch:
    """A time interval of a run.

    Attributes:
        t: times of the samples, shape (m,), the ends included [s].
        paths: configurations of each robot at the samples, in the order of the cell, shape (m, n).
        travel: bound of the travel of any point from sample to sample, shape (m - 1,) [m].
        placements: place of every present object: held, or at rest.
        robots: the robots with what they hold; the samples are the ticks of their clock.
        shapes: of each robot and of what it holds, as ``robots`` has their parts.
        still: fixtures, then objects at rest.
        resting: their shapes, each with its pose.
    """

    t: Array
    paths: Sequence[Array]
    travel: Array
    placements: Mapping[str, Stay]
    robots: Sequence[MovingRobot]
    shapes: Sequence[Sequence[WatchedShape]]
    still: StillParts
    resting: Sequence[tuple[WatchedShape, Transform]]

    def held(self) -> Iterator[tuple[int, WatchedShape, Transform]]:
        """Yield the shapes of held objects with the number of the robot, and their poses in its hand."""
        for k, (moving, shapes) in enumerate(
            zip(self.robots, self.shapes, strict=True)
        ):
            for shape in shapes[len(moving.robot.parts) :]:
                stay = self.placements[shape.entity]
                yield k, shape, shape.at(moving.robot.flange @ stay.pose)


def stretches(world: AuditWorld, replay: ReplayedRun) -> Iterator[RunStretch]:
    """Yield the whole run in order; each stretch starts when the one before it ends."""
    sampler = Sampler(world, replay)
    moved = [rows.t for rows in replay.robots.values()]
    states = list(replay.states())
    knots = np.unique(np.concatenate([[t for t, _ in states], *moved]))
    knots = knots[(knots >= 0.0) & (knots <= replay.end)]
    ends = [*(t for t, _ in states[1:]), replay.end]
    for (start, placements), end in zip(states, ends, strict=True):
        low, high = np.searchsorted(knots, start), np.searchsorted(knots, end, "right")
        inside = knots[low:high]
        for k in range(0, max(len(inside) - 1, 1), _ROWS):
            yield sampler.sample(inside[k : k + _ROWS + 1], placements)


class Sampler:
    """Samples an execution finely enough, with the parts of the cell.

    Args:
        world: the cell.
        replay: the execution.
    """

    def __init__(self, world: AuditWorld, replay: ReplayedRun) -> None:
        self._world, self._cell = world, world.cell
        self._rows = [replay.robots[robot.name] for robot in self._cell.robots]
        self._own = [
            [shape for shape in world.robot_shapes if shape.robot == k]
            for k in range(len(self._cell.robots))
        ]
        self._things = shapes_by_entity((*world.fixtures, *world.objects))
        self._fixtures = [
            self._at_rest(item.name, item.shape, item.pose)
            for item in self._cell.fixtures
        ]
        self._held: dict[Stay, list[ConvexPart]] = {}
        self._resting: dict[Stay, _Resting] = {}
        self._standing = BoundedCache[MovingRobot](_STANDING)

    def sample(self, knots: Array, placements: Mapping[str, Stay]) -> RunStretch:
        """Return a stretch between knots with the current object placements."""
        parts, shapes = [], []
        for robot, placed, own in zip(
            self._world.robots, self._cell.robots, self._own, strict=True
        ):
            held = [stay for stay in placements.values() if stay.holder == placed.name]
            loads = (part for stay in held for part in self._load(robot, stay))
            parts.append([*robot.parts, *loads])
            shapes.append([*own, *self._shapes(held)])
        t, paths, travel = self._sampled(knots, parts)
        lying = [self._rest(s) for s in placements.values() if s.holder is None]
        still = [*self._fixtures, *lying]
        return RunStretch(
            t,
            paths,
            travel,
            placements,
            [
                self._moving(k, *own)
                for k, own in enumerate(zip(parts, paths, strict=True))
            ],
            shapes,
            StillParts.joined([parts for parts, _ in still]),
            [placed for _, own in still for placed in own],
        )

    def _sampled(
        self, knots: Array, parts: Sequence[Sequence[ConvexPart]]
    ) -> tuple[Array, list[Array], Array]:
        """Return times, configurations and travel bounds so that no travel exceeds ``STEP``."""
        weights = [np.array([part.weight for part in own]).T for own in parts]
        t = knots
        for _ in range(_ATTEMPTS):
            paths = [rows.at(t) for rows in self._rows]
            travel = np.zeros(len(t) - 1)
            for path, weight in zip(paths, weights, strict=True):
                far = np.abs(np.diff(path, axis=0)) @ weight
                travel = np.maximum(travel, far.max(axis=1, initial=0.0))
            if np.all(travel <= STEP * _ROUNDING):
                return t, paths, travel
            finer = _split(t, np.ceil(travel / (STEP * _ROUNDING)))
            if len(finer) == len(t):
                break
            t = finer
        raise OutputError(f"robots move too fast to be sampled near {t[0]:.6f} s")

    def _moving(
        self, robot: int, parts: Sequence[ConvexPart], path: Array
    ) -> MovingRobot:
        """Return a robot on its path; one that stands between two samples is known."""

        def moving() -> MovingRobot:
            return MovingRobot(self._world.robots[robot], parts, path)

        if len(path) != 2 or np.any(path[0] != path[1]):
            return moving()
        key = robot, path.tobytes(), *map(id, parts)
        return self._standing.get(key, moving)

    def _load(self, robot: WitnessRobot, stay: Stay) -> list[ConvexPart]:
        """Return the parts of an object in the hand of a robot."""
        if stay not in self._held:
            shape = self._cell.object(stay.object).shape
            self._held[stay] = robot.loads(stay.object, shape, stay.pose)
        return self._held[stay]

    def _rest(self, stay: Stay) -> _Resting:
        """Return an object at rest."""
        if stay not in self._resting:
            shape = self._cell.object(stay.object).shape
            self._resting[stay] = self._at_rest(stay.object, shape, stay.pose)
        return self._resting[stay]

    def _at_rest(self, name: str, shape: Shape, pose: Transform) -> _Resting:
        parts = StillParts.of(resting_parts(name, shape, pose))
        return parts, [(own, own.at(pose)) for own in self._things[name]]

    def _shapes(self, stays: Sequence[Stay]) -> Iterator[WatchedShape]:
        return (shape for stay in stays for shape in self._things[stay.object])


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
