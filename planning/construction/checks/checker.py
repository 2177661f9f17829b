"""Collision checks in space-time, among everything that has been planned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from planning.cell.workcell import Attachment
from planning.construction.checks.clearances import body_limits
from planning.construction.checks.motion_checks import (
    clear_throughout,
    configuration_clear,
    motion_clear,
)
from planning.construction.checks.scene import StillBoxes, lay_out
from planning.construction.world.fixed_world import FixedWorld, Rest
from planning.construction.world.fleet import Carrier, cell_entities, make_carrier
from planning.construction.world.motion_pieces import STEP, cut_timeline
from planning.construction.world.swept_track import SweptTrack, sweep_track
from planning.construction.world.timeline import hand_changes
from planning.construction.world.tracks import build_tracks
from planning.geometry.standing import stand_boxes
from planning.steps.skill import Pairs
from planning.transforms import Array


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

    def _rests(self) -> list[Rest]:
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
    world: FixedWorld, rests: Sequence[Rest]
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
