"""Free space of one robot while all else stands, for planners that ask configuration by configuration."""

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from planning.cell.workcell import Workcell
from planning.transforms import Array, Transform
from twin.audits.worlds.world import (
    AuditWorld,
    WatchedShape,
    overlapping_at_home,
    shapes_by_entity,
)

Held = tuple[str | None, Transform]
"""Who holds an object, None for the world, and its pose in that flange or in the world."""

MARGIN = 0.003
"""So far robots stay away from what they do not touch where a motion begins and ends [m]."""

_SLIP = 0.0005
"""Where a motion begins or ends nearer than that, it comes nearer by this at most [m]."""

COARSE = 0.03
"""No point of a robot moves further between two configurations that a search looks at, about [m]."""

FINE = 2.0 * MARGIN
"""The same for a path that is handed in: what stays ``MARGIN`` away at both does not touch in between [m]."""

_ROOM = 1.2
"""A robot reaches so many times as far in a motion as where it begins, ends and in the middle."""


class FreeSpace:
    """A cell in which one robot is to move.

    Args:
        cell: the cell, with all its objects.
    """

    def __init__(self, cell: Workcell) -> None:
        self.cell = cell
        self._world = AuditWorld(cell)
        self._exempt = overlapping_at_home(self._world)
        self._things = shapes_by_entity((*self._world.fixtures, *self._world.objects))
        self._robot = 0
        self._moved: list[tuple[WatchedShape, Transform | None]] = []
        self._still: list[WatchedShape] = []
        self._frames: tuple[Array, Array, Array] = (np.empty(0),) * 3
        self._pairs: list[tuple[int, int]] = []
        self._limit: dict[tuple[int, int], float] = {}
        self._levers = np.empty(0)
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
        self._moved = [
            (s, None) for s in self._world.robot_shapes if s.robot == self._robot
        ]
        still: list[tuple[WatchedShape, Array, Array]] = []
        flanges = {}
        for name, q in stands.items():
            number = numbers[name]
            self._world.configure(number, q)
            flanges[name] = self._world.flange_poses(number, q[None])[0]
            turn, at = (part[0] for part in self._world.link_frames(number, q[None]))
            still += [
                (s, turn[s.joint + 1], at[s.joint + 1])
                for s in self._world.robot_shapes
                if s.robot == number != self._robot
            ]
        fixtures = {item.name: (None, item.pose) for item in self.cell.fixtures}
        for name, (holder, pose) in {**fixtures, **places}.items():
            if holder == robot:
                self._moved += [(s, s.at(pose)) for s in self._things[name]]
                continue
            world = pose if holder is None else flanges[holder] @ pose
            for shape in self._things[name]:
                own = shape.at(world)
                self._world.place(shape, own)
                still.append((shape, own[:3, :3], own[:3, 3]))
        self._still = [shape for shape, _, _ in still]
        self._frames = (
            np.array([turn @ s.centre + at for s, turn, at in still]),
            np.array([turn @ s.turn for s, turn, _ in still]),
            np.array([s.half for s in self._still]),
        )
        self._pairs = self._own_pairs()
        middle = 0.5 * (ends[0] + ends[1])
        self._levers = _ROOM * np.max(
            [self._reaches(q) for q in (*ends, middle)], axis=0
        )
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

    @property
    def joint_step(self) -> float:
        """Distance of two configurations that a search looks at [rad or m]."""
        return COARSE / float(np.linalg.norm(self._levers))

    def motion_free(self, a: Array, b: Array, way: float = COARSE) -> bool:
        """Tell whether configurations in a straight line are free, the middle ones first.

        Args:
            a, b: its ends, shape (n,).
            way: no point of the robot moves further between two of them, about [m].
        """
        count = max(int(np.ceil(np.abs(b - a) @ self._levers / way)), 1)
        order = sorted(range(1, count), key=lambda k: -(k & -k))
        return self.free(b) and all(self.free(a + (b - a) * k / count) for k in order)

    def _gaps(self, q: Array) -> list[tuple[tuple[int, int], float]]:
        """Return pairs of shapes that are near each other, with their distances [m]."""
        world, number = self._world, self._robot
        world.configure(number, q)
        turn, at = (part[0] for part in world.link_frames(number, q[None]))
        flange = world.flange_poses(number, q[None])[0]
        centres = np.empty((len(self._moved), 3))
        for k, (shape, held) in enumerate(self._moved):
            if held is None:
                centres[k] = turn[shape.joint + 1] @ shape.centre + at[shape.joint + 1]
            else:
                pose = flange @ held
                world.place(shape, pose)
                centres[k] = pose[:3, :3] @ shape.centre + pose[:3, 3]
        reach = np.array([shape.radius for shape, _ in self._moved]) + 2.0 * MARGIN
        middle, axes, half = self._frames
        away = np.einsum("kji,mkj->mki", axes, centres[:, None] - middle[None])
        beyond = np.linalg.norm(np.maximum(np.abs(away) - half, 0.0), axis=2)
        near = np.argwhere(beyond < reach[:, None]).tolist()
        pairs = [(self._moved[i][0], self._still[k]) for i, k in near]
        for i, j in self._pairs:
            apart = np.linalg.norm(centres[i] - centres[j])
            if apart < reach[i] + reach[j]:
                pairs.append((self._moved[i][0], self._moved[j][0]))
        return [
            ((a.number, b.number), world.distance(a, b, 2.0 * MARGIN)) for a, b in pairs
        ]

    def _reaches(self, q: Array) -> Array:
        """Return how far what each joint moves reaches from its axis, shape (n,) [m]; 1 of one that slides."""
        number = self._robot
        turn, at = (part[0] for part in self._world.link_frames(number, q[None]))
        flange = self._world.flange_poses(number, q[None])[0]
        turns = self._world.robots[number].turns
        out = np.where(turns, 0.0, 1.0)
        for shape, held in self._moved:
            if held is None:
                centre = turn[shape.joint + 1] @ shape.centre + at[shape.joint + 1]
            else:
                centre = (flange @ held)[:3, 3] + (flange @ held)[:3, :3] @ shape.centre
            last = len(q) if held is not None else shape.joint + 1
            far = np.linalg.norm(at[1 : last + 1] - centre, axis=1) + shape.radius
            out[:last] = np.maximum(out[:last], far)
        return np.where(turns, out, 1.0)

    def _own_pairs(self) -> list[tuple[int, int]]:
        """Return which of what the robot moves must not touch: two of its links, a link and what it holds.

        A hand may touch what it holds.
        """
        index = {s.number: k for k, s in enumerate(self._world.robot_shapes)}
        found = []
        for i, j in combinations(range(len(self._moved)), 2):
            (a, held_a), (b, held_b) = self._moved[i], self._moved[j]
            if held_a is None and held_b is None:
                exempt = tuple(sorted((index[a.number], index[b.number])))
                if exempt not in self._exempt:
                    found.append((i, j))
            elif held_a is None and not a.entity.endswith("/tool"):
                found.append((i, j))
        return found
