"""Collision checks in space-time, among everything that has been planned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from planning.cell.workcell import Attachment, PlacedRobot, Workcell
from planning.construction.checks.moving_checks import (
    clear_throughout,
    configuration_clear,
    motion_clear,
)
from planning.construction.checks.scene import Limits, StillBoxes, lay_out
from planning.construction.world.fixed_world import FixedWorld, TimedRest
from planning.construction.world.timeline import STEP, cut_timeline, hand_changes
from planning.construction.world.tracks import (
    Carrier,
    SweptTrack,
    build_tracks,
    cell_entities,
    make_carrier,
    sweep_track,
)
from planning.geometry.standing import stand_boxes
from planning.geometry.swept import SKIP
from planning.kinematics.kinematics import joint_poses_of
from planning.motion.sequential import MARGIN
from planning.steps.skill import Pairs
from planning.transforms import Array


class _OwnBody(NamedTuple):
    """A body of a mover.

    Attributes:
        entity: as allowed contacts name it.
        mover: whose it is.
        joint: that carries it.
        part: True for the robot's own, False for what it holds.
        level: how low and how high it is where no joint can change that, else None [m].
    """

    entity: str
    mover: int
    joint: int
    part: bool
    level: tuple[float, float] | None


def body_limits(
    cell: Workcell,
    movers: Sequence[Carrier],
    boxes: Sequence[str],
    bounds: Array,
    numbers: Mapping[str, int],
    allowed: Pairs,
) -> Limits:
    """Return the least distances that the movers' bodies keep: the clearances and a margin.

    Args:
        cell: for its clearances.
        movers: who moves.
        boxes: entity of each piece at rest, those of the cell's fixtures first.
        bounds: least and greatest corner of each, shape (b, 6) [m].
        numbers: of all entities, those of robots first.
        allowed: unordered pairs of entities that may touch.
    """
    between = cell.clearances.robot_robot + MARGIN
    to_objects = cell.clearances.robot_object + MARGIN
    own = [body for m, mover in enumerate(movers) for body in _bodies(m, mover)]
    still = sum(len(fixture.shape.pieces) for fixture in cell.fixtures)
    touchable = [_touchable(body.entity, allowed) for body in own]
    to_boxes = np.full((len(own), len(boxes)), to_objects)
    to_entities = np.full((len(own), len(numbers)), between)
    for i, body in enumerate(own):
        if body.part and body.joint < 0:
            to_boxes[i, :still] = SKIP
        to_entities[i, [numbers[e] for e in touchable[i] if e in numbers]] = SKIP
        to_boxes[i, [name in touchable[i] for name in boxes]] = SKIP
        if body.level is not None:
            # It keeps its level: what is all below or above is never met.
            low, high = body.level
            gap = np.maximum(bounds[:, 2] - high, low - bounds[:, 5])
            to_boxes[i, gap >= to_objects] = SKIP
    return Limits(to_boxes, to_entities, _own_limits(movers, own, touchable, between))


def _own_limits(
    movers: Sequence[Carrier],
    own: Sequence[_OwnBody],
    touchable: Sequence[set[str]],
    between: float,
) -> Array:
    limits = np.full((len(own), len(own)), SKIP)
    first = 0
    for mover in movers:
        last = first + len(mover.names)
        limits[first:last, first:last] = mover.self_limits
        first = last
    for (i, a), (j, b) in combinations(enumerate(own), 2):
        if b.entity in touchable[i]:
            limits[i, j] = SKIP
        elif a.mover != b.mover and (a.joint >= 0 or b.joint >= 0):
            limits[i, j] = between
    return limits


def _bodies(m: int, carrier: Carrier) -> list[_OwnBody]:
    robot, hulls = carrier.robot, carrier.hulls
    corners = np.split(hulls.corners, hulls.corner_first[1:-1])
    return [
        _OwnBody(
            name,
            m,
            joint,
            k < len(robot.model.parts),
            _level(robot, joint, corners[k]),
        )
        for k, (name, joint) in enumerate(
            zip(carrier.names, hulls.joint.tolist(), strict=True)
        )
    ]


def _touchable(name: str, allowed: Pairs) -> set[str]:
    """Return the entities that an entity may touch."""
    return {other for pair in allowed if name in pair for other in pair - {name}}


def _level(
    robot: PlacedRobot, joint: int, corners: Array
) -> tuple[float, float] | None:
    """Return how low and how high a body is where no joint can change that, else None."""
    chain = robot.model.chain
    poses = joint_poses_of(robot, np.zeros(robot.model.dof))
    for j in range(joint + 1):
        up = abs(float((poses[j + 1, :3, :3] @ chain.axis[j])[2]))
        if up > 1e-12 if chain.prismatic[j] else up < 1.0 - 1e-12:
            return None
    z = corners @ poses[joint + 1, 2, :3] + poses[joint + 1, 2, 3]
    return float(z.min()), float(z.max())


class SpaceTimeChecker:
    """Continuous checks of one robot, or of several that move at once, in space-time.

    All other robots follow their timelines, and so do objects. What is found free can become
    nodes of a temporal plan graph with all its guarantees, see ``motion_pieces``.

    Args:
        world: everything planned so far.
        robots: who moves, each from the end of its timeline on.
        held: what they hold from then on, object name to attachment; what ``world`` says where
            not given.
        allowed: unordered pairs of entities that may touch.

    Attributes:
        robots: names of the movers; configurations are theirs, one after another.
        start: the earliest time from which on one of them moves [s].
        begin, begin_of_joint: that of each mover, and of each joint [s].
        lower, upper, velocity: limits of the joints, shape (n,).
        rest: configuration of HOME, shape (n,).
        leans: False for joints that drive, True for all others, shape (n,).
        scene: all of it for compiled code.
    """

    def __init__(
        self,
        world: FixedWorld,
        robots: Sequence[str],
        *,
        held: Mapping[str, Attachment] | None = None,
        allowed: Pairs = frozenset(),
    ) -> None:
        self.world = world
        self.robots = tuple(robots)
        cell = world.cell
        self.begin = np.array([world.robots[name].end for name in self.robots])
        self.start = float(self.begin.min())
        self.models = tuple(cell.robot(name).model for name in self.robots)
        self.lower = np.concatenate([m.lower for m in self.models])
        self.upper = np.concatenate([m.upper for m in self.models])
        self.velocity = np.concatenate([m.velocity for m in self.models])
        self.rest = np.concatenate([cell.robot(name).home for name in self.robots])
        self.leans = np.concatenate(
            [np.arange(m.dof) >= (3 if m.is_mobile else 0) for m in self.models]
        )
        self.begin_of_joint = np.repeat(self.begin, [m.dof for m in self.models])
        self._held = self._held_by_movers() if held is None else held
        numbers = cell_entities(cell)
        movers = [self._mover(name) for name in self.robots]
        swept = self._swept()
        # The scene does not keep them alive.
        self._carriers = [*movers, *(c for track in swept for c in track.carriers)]
        names, boxes = _still_boxes(world, self._rests())
        limits = body_limits(cell, movers, names, boxes.bounds, numbers, allowed)
        tracks = build_tracks(swept, len(movers))
        self.scene = lay_out(self._carriers, numbers, tracks, boxes, limits, self.begin)

    def start_configuration(self) -> Array:
        """Return where the movers are when each becomes free to move, shape (n,)."""
        return np.concatenate(
            [self.world.robots[name].path[-1] for name in self.robots]
        )

    def configuration_free(self, q: Array, t: float) -> bool:
        """Tell whether the movers may be at ``q``, shape (n,), at time ``t``."""
        return bool(configuration_clear(self.scene, _c(q), float(t)))

    def motion_free(self, q0: Array, t0: float, q1: Array, t1: float) -> bool:
        """Tell whether the whole straight motion from (q0, t0) to (q1, t1) is free.

        A mover that is not free to move at ``t0`` sets out when it is, and arrives like all
        the others at ``t1``. Speeds are not looked at.
        """
        return bool(motion_clear(self.scene, _c(q0), float(t0), _c(q1), float(t1)))

    def skill_free(self, path: Array, start: float, end: float) -> bool:
        """Tell whether a skill is free: all of its path, during all of a span of time.

        Args:
            path: what the movers do, straight from waypoint to waypoint, shape (w, n); one
                waypoint for a stand.
            start, end: the span [s].
        """
        path = np.array(np.atleast_2d(path), dtype=np.float64)
        following = path[1:] if len(path) > 1 else path
        return all(
            clear_throughout(self.scene, a, b, float(start), float(end))
            for a, b in zip(path, following, strict=False)
        )

    def least_duration(self, q0: Array, q1: Array) -> float:
        """Return the time that the slowest joint needs from ``q0`` to ``q1`` [s]."""
        return float(np.max(np.abs(_c(q1) - _c(q0)) / self.velocity))

    def _held_by_movers(self) -> dict[str, Attachment]:
        return {
            name: found
            for robot, begin in zip(self.robots, self.begin.tolist(), strict=True)
            for name, line in self.world.objects.items()
            if (found := line.at(begin)) is not None and found.holder == robot
        }

    def _mover(self, robot: str) -> Carrier:
        cell = self.world.cell
        hand = tuple(
            (cell.object(name), at.pose)
            for name, at in self._held.items()
            if at.holder == robot
        )
        return make_carrier(cell.robot(robot), hand)

    def _swept(self) -> list[SweptTrack]:
        """Return what the others sweep, and movers until they are free to move."""
        world, cell = self.world, self.world.cell
        tracks: list[SweptTrack] = []
        until = dict(zip(self.robots, self.begin.tolist(), strict=True))
        for robot in cell.robots:
            last = until.get(robot.name, np.inf)
            if last <= self.start:
                continue
            changes = [
                (t, tuple((o, p) for o, p in hand if o not in self._held))
                for t, hand in hand_changes(world.objects, robot.name)
            ]
            line = world.robots[robot.name]
            if last == np.inf:
                track = world.swept.since(self.start, robot, line, changes, cell.object)
            else:
                times = [t for t, _ in changes[1:]]
                pieces = cut_timeline(line, self.start, last, STEP, times)
                track = sweep_track(robot, pieces, changes, cell.object)
            tracks.append(track)
        return tracks

    def _rests(self) -> list[TimedRest]:
        return [
            rest
            for item in self.world.cell.objects
            if item.name not in self._held
            for rest in self.world.rests(item.name)
            if rest.end > self.start
        ]


def _c(q: Array) -> Array:
    """Return a writable contiguous array: numba compiles read-only ones anew."""
    return np.array(q, dtype=np.float64)


def _still_boxes(
    world: FixedWorld, rests: Sequence[TimedRest]
) -> tuple[tuple[str, ...], StillBoxes]:
    """Return fixtures and objects where they lie, names first."""
    cell = world.cell
    items = [(rest, cell.object(rest.object)) for rest in rests]
    boxes = stand_boxes(
        cell.fixtures,
        [piece for r, i in items for piece in i.shape.placed(r.object, r.pose)],
    )
    each = [r for r, i in items for _ in i.shape.pieces]
    always = np.full(boxes.fixtures, np.inf)
    return boxes.names, StillBoxes(
        boxes.pose,
        boxes.half,
        boxes.bounds,
        np.append(-always, [r.start for r in each]),
        np.append(always, [r.end for r in each]),
        np.arange(len(boxes.names)),
        boxes.hulls,
    )
