"""May robots be here at this time, or move like that from then to then, among all that is planned?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from planning.cell.workcell import Attachment, Workcell
from planning.construction.checks.body_limits import body_limits
from planning.construction.checks.motion_checks import (
    clear_throughout,
    clear_until,
    configuration_clear,
    motion_clear,
)
from planning.construction.checks.obstacles import StillBoxes, lay_out
from planning.construction.world.entities import entity_numbers
from planning.construction.world.fixed_world import FixedWorld
from planning.construction.world.fleet import Carrier, build_fleet
from planning.construction.world.hands import hand_changes
from planning.construction.world.motion_pieces import cut_timeline
from planning.construction.world.rests import Rest, rests_of
from planning.construction.world.swept_track import SweptTrack, carriers_of, sweep_track
from planning.construction.world.tracks import build_tracks
from planning.geometry.exact import resting_solid
from planning.geometry.hull_table import standing_hulls
from planning.motion.sequential import MARGIN
from planning.robots.mobile import is_mobile
from planning.transforms import Array, Indices

STEP = 0.1
"""Length of the cells of time, and of pose nodes [s]."""

HALVINGS = 3
"""How often a cell may be halved where robots are close."""

Pairs = frozenset[frozenset[str]]


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
        margin: added to the cell's clearances [m].
        step: length of the cells of time [s].
        halvings: how often a cell may be halved where robots are close.

    Attributes:
        robots: names of the movers; configurations are theirs, one after another.
        start: the earliest time from which on one of them moves [s].
        rest: configuration of HOME, shape (n,).
        leans: False for joints that drive, True for all others, shape (n,).
    """

    def __init__(
        self,
        world: FixedWorld,
        robots: Sequence[str],
        *,
        held: Mapping[str, Attachment] | None = None,
        allowed: Pairs = frozenset(),
        margin: float = MARGIN,
        step: float = STEP,
        halvings: int = HALVINGS,
    ) -> None:
        self.world = world
        self.robots = tuple(robots)
        self.step = step
        cell = world.cell
        self.begin = np.array([world.robots[name].end for name in self.robots])
        self.start = float(self.begin.min())
        self.models = tuple(cell.robot(name).model for name in self.robots)
        self.lower = np.concatenate([m.lower for m in self.models])
        self.upper = np.concatenate([m.upper for m in self.models])
        self.velocity = np.concatenate([m.velocity for m in self.models])
        ends = np.cumsum([0, *(m.dof for m in self.models)]).tolist()
        self.joints = tuple(slice(a, b) for a, b in zip(ends, ends[1:], strict=False))
        self.rest = np.concatenate([cell.robot(name).home for name in self.robots])
        self.leans = np.concatenate(
            [np.arange(m.dof) >= (3 if is_mobile(m) else 0) for m in self.models]
        )
        self.begin_of_joint = np.repeat(self.begin, [m.dof for m in self.models])
        if held is None:
            held = {
                name: found
                for robot, begin in zip(self.robots, self.begin, strict=True)
                for name, found in world.state_at(float(begin)).attachments.items()
                if found.holder == robot
            }
        self.held = dict(held)
        self._allowed = allowed
        self._margin = margin
        self._numbers = entity_numbers(cell)
        carriers, swept, which = self._carriers()
        fleet = build_fleet(carriers, self._numbers.__getitem__)
        names, boxes = _still_boxes(world, self._rests())
        limits = body_limits(
            world.cell,
            carriers[: len(self.robots)],
            names,
            boxes.bounds,
            self._numbers,
            allowed,
            margin,
        )
        tracks = build_tracks(swept, which)
        self._memory = lay_out(fleet, tracks, boxes, limits, self.begin, step, halvings)
        self.scene = self._memory.arena

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

    def free_until(self, q0: Array, t0: float, q1: Array, t1: float) -> float:
        """Return until when the motion from (q0, t0) to (q1, t1) is free, at most ``t1``."""
        return float(clear_until(self.scene, _c(q0), float(t0), _c(q1), float(t1))[1])

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

    def _carriers(self) -> tuple[list[Carrier], list[SweptTrack], list[Indices]]:
        """Return movers and other carriers, tracks of the others and which carrier each piece is."""
        world, cell = self.world, self.world.cell
        carriers: list[Carrier] = []
        for name in self.robots:
            hand = tuple(
                (cell.object(o), a.pose)
                for o, a in self.held.items()
                if a.holder == name
            )
            carriers.append((cell.robot(name), hand))
        tracks: list[SweptTrack] = []
        which: list[Indices] = []
        until = dict(zip(self.robots, self.begin.tolist(), strict=True))
        for robot in cell.robots:
            last = until.get(robot.name, np.inf)
            if last <= self.start:
                continue
            changes = [
                (t, tuple((o, p) for o, p in hand if o not in self.held))
                for t, hand in hand_changes(world.objects, robot.name)
            ]
            line = world.robots[robot.name]
            if last == np.inf:
                track = world.swept.since(
                    self.start, robot, line, changes, cell.object, self.step
                )
            else:
                times = [t for t, _ in changes[1:]]
                pieces = cut_timeline(line, self.start, last, self.step, times)
                track = sweep_track(robot, pieces, changes, cell.object)
            tracks.append(track)
            which.append(len(carriers) + track.hand)
            carriers += carriers_of(robot, track.hands, cell.object)
        return carriers, tracks, which

    def _rests(self) -> list[Rest]:
        return [
            rest
            for item in self.world.cell.objects
            if item.name not in self.held
            for rest in rests_of(self.world, item.name)
            if rest.end > self.start
        ]


def _c(q: Array) -> Array:
    """Return a writable contiguous array: numba compiles read-only ones anew."""
    return np.array(q, dtype=np.float64)


def no_boxes(cell: Workcell) -> StillBoxes:
    """Return a world in which nothing lies."""
    return _still_boxes(FixedWorld(replace(cell, fixtures=(), objects=())), [])[1]


def _still_boxes(
    world: FixedWorld, rests: Sequence[Rest]
) -> tuple[list[str], StillBoxes]:
    """Return fixtures and objects where they lie, names first."""
    cell = world.cell
    items = [cell.object(r.object) for r in rests]
    count = len(cell.fixtures)
    names = [f.name for f in cell.fixtures] + [r.object for r in rests]
    bodies = [f.body for f in cell.fixtures] + [i.body for i in items]
    poses = [f.pose for f in cell.fixtures] + [r.pose for r in rests]
    sizes = [f.size for f in cell.fixtures] + [i.size for i in items]
    solids = [
        resting_solid(name, body, pose)
        for name, body, pose in zip(names, bodies, poses, strict=True)
    ]
    pose = np.array(poses, dtype=np.float64).reshape(-1, 4, 4)
    half = 0.5 * np.array(sizes, dtype=np.float64).reshape(-1, 3)
    reach = (np.abs(pose[:, :3, :3]) @ half[:, :, None])[:, :, 0]
    centre = pose[:, :3, 3]
    return names, StillBoxes(
        pose,
        half,
        np.hstack([centre - reach, centre + reach]),
        np.array([-np.inf] * count + [r.start for r in rests]),
        np.array([np.inf] * count + [r.end for r in rests]),
        standing_hulls(solids, bodies),
    )
