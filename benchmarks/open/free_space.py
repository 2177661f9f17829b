"""Free space of one robot while all else stands, for planners that ask configuration by configuration."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np

from planning.cell.workcell import Workcell
from planning.transforms import Array, Transform
from twin.audit.worlds.engines import open_world
from twin.audit.worlds.world import WatchedShape, overlapping_at_home, shapes_by_entity

Held = tuple[str | None, Transform]
"""Who holds an object, None for the world, and its pose in that flange or in the world."""

MARGIN = 0.003
"""So far robots stay away from what they do not touch where a motion begins and ends [m]."""

_SLIP = 0.0005
"""Where a motion begins or ends nearer than that, it comes nearer by this at most [m]."""

STEP = 0.01
"""Joints move by this at most between two configurations that are looked at [rad or m]."""


class FreeSpace:
    """A cell in which one robot is to move.

    Args:
        cell: the cell, with all its objects.
    """

    def __init__(self, cell: Workcell) -> None:
        self.cell = cell
        self._world = open_world(cell)
        self._exempt = overlapping_at_home(self._world)
        self._things = shapes_by_entity((*self._world.fixtures, *self._world.objects))
        self._robot = 0
        self._moved: list[tuple[WatchedShape, Transform | None]] = []
        self._still: list[WatchedShape] = []
        self._at = np.empty((0, 3))
        self._reach = np.empty(0)
        self._limit: dict[tuple[int, int], float] = {}
        self.checks = 0

    def begin(
        self,
        robot: str,
        stands: Mapping[str, Array],
        places: Mapping[str, Held],
        ends: tuple[Array, Array],
    ) -> None:
        """Set the scene of a motion.

        Args:
            robot: who moves.
            stands: where every robot stands.
            places: of all objects that are there.
            ends: where the motion begins and ends, which are taken to be free.
        """
        numbers = {item.name: k for k, item in enumerate(self.cell.robots)}
        self._robot = numbers[robot]
        shapes = self._world.robot_shapes
        self._moved = [(s, None) for s in shapes if s.robot == self._robot]
        self._still = [s for s in shapes if s.robot != self._robot]
        centres = []
        flanges = {}
        for name, q in stands.items():
            self._world.configure(numbers[name], q)
            flanges[name] = self._world.flange_poses(numbers[name], q[None])[0]
            turn, at = (
                part[0] for part in self._world.link_frames(numbers[name], q[None])
            )
            centres += [
                (turn[s.joint + 1] @ s.centre + at[s.joint + 1], s)
                for s in self._still
                if s.robot == numbers[name]
            ]
        self._still = [shape for _, shape in centres]
        fixtures = {item.name: (None, item.pose) for item in self.cell.fixtures}
        for name, (holder, pose) in {**fixtures, **places}.items():
            if holder == robot:
                self._moved += [(s, s.at(pose)) for s in self._things[name]]
                continue
            world = pose if holder is None else flanges[holder] @ pose
            for shape in self._things[name]:
                at = shape.at(world)
                self._world.place(shape, at)
                self._still.append(shape)
                centres.append((at[:3, :3] @ shape.centre + at[:3, 3], shape))
        self._at = np.array([at for at, _ in centres])
        self._reach = np.array([shape.radius for shape in self._still])
        self._limit = {}
        for q in ends:
            for pair, gap in self._gaps(q):
                near = min(gap - _SLIP, MARGIN)
                self._limit[pair] = min(self._limit.get(pair, MARGIN), near)

    def free(self, q: Array) -> bool:
        """Tell whether the robot may be at a configuration, shape (n,)."""
        self.checks += 1
        gaps = self._gaps(q)
        return all(gap >= self._limit.get(pair, MARGIN) for pair, gap in gaps)

    def motion_free(self, a: Array, b: Array, step: float = STEP) -> bool:
        """Tell whether configurations in a straight line are free, the middle ones first."""
        count = max(int(np.ceil(np.max(np.abs(b - a)) / step)), 1)
        order = sorted(range(1, count), key=lambda k: -(k & -k))
        return self.free(b) and all(self.free(a + (b - a) * k / count) for k in order)

    def _gaps(self, q: Array) -> list[tuple[tuple[int, int], float]]:
        """Return pairs of shapes that are near each other, with their distances [m]."""
        world, number = self._world, self._robot
        world.configure(number, q)
        turn, at = (part[0] for part in world.link_frames(number, q[None]))
        flange = world.flange_poses(number, q[None])[0]
        own = []
        for shape, held in self._moved:
            if held is None:
                frame = turn[shape.joint + 1], at[shape.joint + 1]
            else:
                pose = flange @ held
                world.place(shape, pose)
                frame = pose[:3, :3], pose[:3, 3]
            own.append((shape, frame[0] @ shape.centre + frame[1], held))
        found = []
        for shape, centre, _ in own:
            far = np.linalg.norm(self._at - centre, axis=1)
            near = np.flatnonzero(far < self._reach + shape.radius + 2.0 * MARGIN)
            for k in near.tolist():
                other = self._still[k]
                gap = world.distance(shape, other, 2.0 * MARGIN)
                found.append(((shape.number, other.number), gap))
        index = {s.number: k for k, s in enumerate(world.robot_shapes)}
        for (a, at_a, held_a), (b, at_b, held_b) in product(own, own):
            if (
                a.number >= b.number
                or np.linalg.norm(at_a - at_b) > a.radius + b.radius
            ):
                continue
            if held_a is None and held_b is None:
                i, j = sorted((index[a.number], index[b.number]))
                if (i, j) in self._exempt:
                    continue
            elif (held_a is None) == (held_b is None):
                continue
            gap = world.distance(a, b, 2.0 * MARGIN)
            found.append(((a.number, b.number), gap))
        return found
