"""Which moving shapes come near each other or boxes at rest, and at which samples.

Bounds of distances from below, many pairs at a time: between spheres, between upright boxes, and
from the box that is turned with a shape to the sphere around the other.

Stretches of a run in which nobody takes or leaves an object, sampled finely enough.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from planning.errors import OutputError
from planning.transforms import Array, Indices, Transform
from scheduling.witness.robot import WitnessRobot
from twin.audit.motion.executed import ReplayedRun, Stay
from twin.audit.motion.reach import RobotSamples, motion_bounds
from twin.audit.worlds.world import AuditWorld, WatchedShape, shapes_by_entity


@dataclass(frozen=True, eq=False)
class Track:
    """A shape, and what it moves with.

    Attributes:
        shape: the shape.
        holder: index of the robot that moves it, None at rest.
        link: index of the link it moves with, 0 for the base.
        pose: of it in the frame of its link, None of a robot's own; in the world, at rest.
    """

    shape: WatchedShape
    holder: int | None
    link: int
    pose: Transform | None


_AT_ONCE = 400_000
"""So many pairs times samples are looked at at once, to bound memory."""


@dataclass(frozen=True)
class Movers:
    """The spheres and boxes around k moving shapes at m samples.

    Attributes:
        tracks: of the shapes.
        centre: shape (m, k, 3) [m].
        turn: rotations of boxes that are turned with the shapes, shape (m, k, 3, 3).
        reach: half edges of upright boxes, shape (m, k, 3) [m].
        half: half edges of the turned boxes, shape (k, 3) [m].
        radius: of the spheres, shape (k,) [m].
        bounds: how far any point of a shape gets at most from sample to sample, as seen from the
            base and each moved link of its robot, shape (m - 1, k, links) [m].
    """

    tracks: Sequence[Track]
    centre: Array
    turn: Array
    reach: Array
    half: Array
    radius: Array
    bounds: Array

    @cached_property
    def steps(self) -> Array:
        """How far any point of a shape gets in the world, step by step, shape (m - 1, k) [m]."""
        return np.asarray(self.bounds[:, :, 0])

    @cached_property
    def moved(self) -> Array:
        """How far any point of a shape gets until the sample before or the one after, (m, k) [m]."""
        steps = np.pad(self.steps, ((1, 1), (0, 0)))
        return np.maximum(steps[:-1], steps[1:])[: len(self.centre)]

    @cached_property
    def low(self) -> Array:
        """Least corners of the upright boxes around all the way, shape (k, 3) [m]."""
        return np.asarray((self.centre - self.reach).min(axis=0))

    @cached_property
    def high(self) -> Array:
        """Greatest corners of those, shape (k, 3) [m]."""
        return np.asarray((self.centre + self.reach).max(axis=0))

    def at_first(self) -> Movers:
        """Return the same at the first sample alone."""
        first = {key: getattr(self, key)[:1] for key in ("centre", "turn", "reach")}
        return replace(self, **first)

    def near_movers(
        self, first: Indices, second: Indices, room: Array
    ) -> Iterator[tuple[int, list[int]]]:
        """Yield which pairs may come nearer than some room, and at which samples.

        Args:
            first, second: the pairs, shape (p,).
            room: of each, besides what they move, shape (p,) [m].
        """
        most = self.moved.max(axis=0)
        apart = np.maximum(
            self.low[first] - self.high[second], self.low[second] - self.high[first]
        )
        coarse = room + most[first] + most[second]
        some = np.flatnonzero(_outside(apart) <= coarse)
        for n, samples in self._near(first[some], self, second[some], room[some]):
            yield int(some[n]), samples

    def near_boxes(
        self, movers: Indices, boxes: Movers
    ) -> Iterator[tuple[int, int, list[int]]]:
        """Yield which shapes may come near which boxes at rest, and at which samples.

        Args:
            movers: numbers of the shapes.
            boxes: at rest.
        """
        most = self.moved.max(axis=0)[movers, None]
        low, high = self.low[movers] - most, self.high[movers] + most
        # Most boxes are far from all shapes.
        there = (boxes.high >= low.min(axis=0)) & (boxes.low <= high.max(axis=0))
        some = np.flatnonzero(there.all(axis=1))
        near = (low[:, None] <= boxes.high[some]) & (high[:, None] >= boxes.low[some])
        rows, columns = np.nonzero(near.all(axis=2))
        first, second = movers[rows], some[columns]
        for n, samples in self._near(first, boxes, second, np.zeros(len(first))):
            yield int(first[n]), int(second[n]), samples

    def _near(
        self, first: Indices, other: Movers, second: Indices, room: Array
    ) -> Iterator[tuple[int, list[int]]]:
        """Yield which pairs with others, of as many samples or one, come near, and when."""
        for some in self._parts(len(first)):
            i, j = first[some], second[some]
            away = other.centre[:, j] - self.centre[:, i]
            reach = self.radius[i] + other.radius[j]
            gap = np.sqrt(np.sum(away * away, axis=2)) - reach
            upright = _outside(np.abs(away) - self.reach[:, i] - other.reach[:, j])
            limit = room[some] + self.moved[:, i] + other.moved[:, j]
            close = np.maximum(gap, upright) <= limit
            kept = np.flatnonzero(close.any(axis=0))
            if not len(kept):
                continue
            i, j, close, away = i[kept], j[kept], close[:, kept], away[:, kept]
            limit = limit[:, kept]
            close &= self._from_boxes(i, away) <= limit + other.radius[j]
            close &= other._from_boxes(j, away) <= limit + self.radius[i]
            rows, columns = np.nonzero(close.T)
            ends = np.flatnonzero(np.diff(rows)) + 1
            parts = np.split(rows, ends), np.split(columns, ends)
            for part_rows, samples in zip(*parts, strict=True):
                if len(samples):
                    yield int(some[kept[part_rows[0]]]), samples.tolist()

    def _parts(self, count: int) -> Iterator[Indices]:
        size = max(1, _AT_ONCE // len(self.centre))
        for start in range(0, count, size):
            yield np.arange(start, min(start + size, count))

    def _from_boxes(self, shapes: Indices, away: Array) -> Array:
        """Return how far points are from the turned boxes of shapes, shape (m, p) [m].

        Args:
            shapes: p of them.
            away: of a point from the centre of each, or the other way round, shape (m, p, 3).
        """
        local = np.einsum("mpi,mpij->mpj", away, self.turn[:, shapes])
        return _outside(np.abs(local) - self.half[shapes])


class StandingTable:
    """Table of the fixtures, and of the objects that are at rest now: only what changes is worked out.

    Args:
        world: the cell.
    """

    def __init__(self, world: AuditWorld) -> None:
        shapes = [*world.fixtures, *world.objects]
        self._shapes: dict[str, list[tuple[int, WatchedShape]]] = {}
        for k, shape in enumerate(shapes):
            self._shapes.setdefault(shape.entity, []).append((k, shape))
        self._tracks: list[Track | None] = [None] * len(shapes)
        self._centre, self._reach = np.zeros((2, len(shapes), 3))
        self._turn = np.zeros((len(shapes), 3, 3))
        self._half = np.array([shape.half for shape in shapes]).reshape(-1, 3)
        self._radius = np.array([shape.radius for shape in shapes])
        self._placements: Mapping[str, Stay] = {}
        for item in world.cell.fixtures:
            self._put(item.name, item.pose)

    def change(self, placements: Mapping[str, Stay]) -> None:
        """Take over where objects are from now on."""
        for name, stay in placements.items():
            if self._placements.get(name) is not stay:
                self._put(name, None if stay.holder is not None else stay.pose)
        for name in self._placements.keys() - placements.keys():
            self._put(name, None)
        self._placements = placements

    def boxes(self) -> Movers:
        """Return what stands now, at one sample."""
        there = [k for k, track in enumerate(self._tracks) if track is not None]
        return Movers(
            [track for track in self._tracks if track is not None],
            self._centre[None, there],
            self._turn[None, there],
            self._reach[None, there],
            self._half[there],
            self._radius[there],
            np.zeros((0, len(there), 1)),
        )

    def _put(self, name: str, pose: Transform | None) -> None:
        for k, shape in self._shapes[name]:
            self._tracks[k] = None
            if pose is not None:
                at = shape.at(pose)
                self._tracks[k] = Track(shape, None, 0, at)
                self._centre[k], self._turn[k] = at[:3, 3], at[:3, :3]
                self._reach[k] = np.abs(at[:3, :3]) @ shape.half


class MovedShapes:
    """All that one robot moves: its own shapes, then the objects that it holds.

    Args:
        robot: its index.
        own: its shapes.
        held: the shapes that it holds, each with its pose in the frame of the hand.
        hand: index of the link that they move with.

    Attributes:
        tracks: of the shapes.
    """

    def __init__(
        self,
        robot: int,
        own: Sequence[WatchedShape],
        held: Sequence[tuple[WatchedShape, Transform]],
        hand: int,
    ) -> None:
        self.tracks = [
            *(Track(shape, robot, shape.joint + 1, None) for shape in own),
            *(Track(shape, robot, hand, pose) for shape, pose in held),
        ]
        at = [(track.shape, track.pose) for track in self.tracks]
        centres = [s.centre if pose is None else pose[:3, 3] for s, pose in at]
        turns = [s.turn if pose is None else pose[:3, :3] @ s.turn for s, pose in at]
        self._links = np.array([track.link for track in self.tracks], dtype=np.int64)
        self._centre = np.array(centres).reshape(-1, 3)
        self._turn = np.array(turns).reshape(-1, 3, 3)
        self._half = np.array([shape.half for shape, _ in at]).reshape(-1, 3)
        self._radius = np.array([shape.radius for shape, _ in at])

    def sampled(self, robot: WitnessRobot, samples: RobotSamples) -> Movers:
        """Return them at some samples of the robot."""
        rotation = samples.rotation[:, self._links]
        centre = np.einsum("msij,sj->msi", rotation, self._centre)
        centre += samples.position[:, self._links]
        turn = rotation @ self._turn
        reach = np.einsum("msij,sj->msi", np.abs(turn), self._half)
        bounds = motion_bounds(robot, samples, self._links, centre, self._radius)
        around = reach, self._half, self._radius
        return Movers(self.tracks, centre, turn, *around, bounds)


def joined_movers(parts: Sequence[Movers], order: Sequence[int]) -> Movers:
    """Return the shapes of all robots in an order."""
    tracks = [track for part in parts for track in part.tracks]
    links = max(part.bounds.shape[2] for part in parts)
    bounds = [
        np.pad(part.bounds, ((0, 0), (0, 0), (0, links - part.bounds.shape[2])))
        for part in parts
    ]

    def joined(arrays: Sequence[Array], axis: int) -> Array:
        return np.take(np.concatenate(arrays, axis=axis), order, axis=axis)

    return Movers(
        [tracks[k] for k in order],
        joined([part.centre for part in parts], 1),
        joined([part.turn for part in parts], 1),
        joined([part.reach for part in parts], 1),
        joined([part.half for part in parts], 0),
        joined([part.radius for part in parts], 0),
        joined(bounds, 1),
    )


def _outside(apart: Array) -> Array:
    """Return the length of what is apart along axes, 0 where nothing is, shape (..., 3) [m]."""
    gap = np.maximum(apart, 0.0)
    return np.asarray(np.sqrt(np.sum(gap * gap, axis=-1)))


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
    """Samples an execution finely enough, with what is known of a cell's shapes.

    Args:
        world: the cell.
        replay: what was executed.

    Attributes:
        standing: table of what is at rest now.
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
        """Return a stretch between knots, in which objects are where they are now."""
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
        """Return all that a robot moves now."""
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
