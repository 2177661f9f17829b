"""Collision checks of one moving robot among static obstacles."""

from __future__ import annotations

import operator
from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from itertools import pairwise, product
from typing import NamedTuple

import coal
import numpy as np

from planning.cell.workcell import PoseError, Workcell, WorldState
from planning.geometry.clearing import BOX, CLEAR, CompiledScene, find_undecided
from planning.geometry.exact import (
    TOLERANCE,
    Solid,
    hull_distance,
    hull_distance_at,
    may_come_close,
    place_at_middle,
    shape_distance,
)
from planning.geometry.overlap_bounds import find_unproved
from planning.geometry.robot_bodies import (
    Held,
    entity_name,
    mark_allowed_contacts,
    objects_held_by,
    robot_bodies,
    with_deviations,
)
from planning.geometry.separation import make_scratch_for
from planning.geometry.standing import (
    StandingBoxes,
    box_limits,
    sort_objects,
    standing_robot,
)
from planning.geometry.swept import SKIP
from planning.geometry.work_arrays import work_arrays
from planning.kinematics.kinematics import frame_pose
from planning.packed import packed
from planning.transforms import Array

_TOUCHING = 5e-5
"""Distance or depth of overlap below which messages say that bodies touch [m]."""

_FINE = 2e-5
"""Tolerance of the check whether a motion exceeds an allowed overlap [m]."""

_LENGTH = 1e-6
"""Greatest error of the length of a measured axis."""

_AXES = 4
"""Number of axes that are measured, one after another, to prove that a tool keeps a limit."""

_PROVED = _FINE + 1e-5
"""Distance beyond a limit at which a bound is sure to agree with the exact decision: its tolerance, and errors of
measured depths [m]."""


class BodyPair(NamedTuple):
    """A body of a robot and an obstacle, which is carried by the robot or at rest.

    Attributes:
        mine, other: the body of the robot, and the obstacle.
        limit: least distance, for all base errors [m].
        together: whether the robot carries both.
    """

    mine: Solid
    other: Solid
    limit: float
    together: bool

    def gap_at(self, q: Array) -> tuple[float, float]:
        """Return their signed distance at ``q``, shape (n,), and the clearance required there [m]."""
        pose, limit = place_at_middle(self.mine, q, q)[0], self.limit
        if not self.together:
            limit += self.mine.deviation_bound_with_base(pose)
        there = place_at_middle(self.other, q, q)[0]
        return hull_distance(self.mine, pose, self.other, there), limit


@dataclass(frozen=True)
class Contact:
    """Two bodies that are too close.

    Attributes:
        first: the checked robot's body, as entity and body name.
        second: the other one.
        distance: signed distance, negative for penetration [m].
        limit: required least distance [m].
        pair: the bodies themselves.
    """

    first: str
    second: str
    distance: float
    limit: float
    pair: BodyPair | None = field(default=None, compare=False, repr=False)

    @property
    def moving(self) -> str:
        """Entity of the first body: the robot's arm or tool, or an object that it holds."""
        return self.first.split(":")[0]

    @property
    def obstacle(self) -> str:
        """Entity of the second body: an object, a fixture, or the arm or tool of a robot."""
        return self.second.split(":")[0]

    def __str__(self) -> str:
        """Describe the contact in one phrase."""
        if abs(self.distance) < _TOUCHING:
            return f"{self.first} and {self.second} touch"
        how = (
            f"overlap by {-self.distance * 1e3:.1f} mm"
            if self.distance < 0
            else f"come within {self.distance * 1e3:.1f} mm"
        )
        return f"{self.first} and {self.second} {how}"


class SceneChecker:
    """Collision checks of one robot against everything else, which is static.

    Capsules around the bodies find close pairs quickly, and most are then proved apart by the moving hulls. For the
    others, the coal library measures distances.

    Args:
        cell: the static cell.
        robot: name of the robot that is checked.
        state: configurations of the other robots, and poses of objects. Objects that the checked robot holds
            move with it; objects without a pose are absent.
        allowed: unordered pairs of entities that may touch.
        margin: addition to the clearances of the cell [m].
        surroundings: objects that the checked robot holds, and everything else, see ``plus_robots``; they replace
            those of the cell and the state.
        deviating: a path, shape (w, n), and the greatest deviation of the flange from it; if given, only motions
            of this path are checked.
    """

    def __init__(
        self,
        cell: Workcell,
        robot: str,
        state: WorldState,
        allowed: frozenset[frozenset[str]] = frozenset(),
        *,
        margin: float = 0.0,
        surroundings: tuple[Sequence[Held], StandingBoxes] | None = None,
        deviating: tuple[Array, PoseError] | None = None,
    ) -> None:
        held, boxes = surroundings or _surroundings(cell, robot, state)
        self.robot = cell.robot(robot)
        self._to_robots = cell.clearances.robot_robot + margin
        self._to_objects = cell.clearances.robot_object + margin
        self._own = robot_bodies(self.robot, held)
        if deviating is not None:
            self._own = with_deviations(self._own, self.robot, *deviating)
        self._boxes = boxes
        self._gone: tuple[int, ...] = ()
        self._box_limit = box_limits(
            self._own, boxes, (), self._to_objects, self._to_robots
        )
        work = work_arrays(self._own.hulls)
        n, corners = self.robot.model.dof, self._own.hulls.most_corners
        none, count = np.empty((0, 0)), len(self._own.solids)
        self._scene = CompiledScene(
            work.own,
            boxes.hulls,
            boxes.pose,
            boxes.half,
            boxes.bounds,
            none,
            none,
            work.above,
            make_scratch_for(n, 0, corners, boxes.places.most_corners),
            work.on_itself,
            np.zeros((count, count, 3)),
        )
        self._allow(allowed)

    def with_allowed(self, allowed: frozenset[frozenset[str]]) -> SceneChecker:
        """Return the same checker with other allowed contacts; the two share caches."""
        other = copy(self)
        other._allow(allowed)
        return other

    def without(self, objects: Iterable[str]) -> SceneChecker:
        """Return the same checker without some objects at rest."""
        other = copy(self)
        columns = self._boxes.columns
        gone = {k for name in objects for k in columns.get(name, ())}
        other._gone = tuple({*self._gone, *gone})
        limits = self._scene.box_limit.copy()
        limits[:, list(other._gone)] = SKIP
        other._scene = packed(self._scene._replace(box_limit=limits))
        return other

    def _allow(self, allowed: frozenset[frozenset[str]]) -> None:
        """Write the least distances to obstacles and between own bodies.

        Objects held by robots keep the clearance between robots from other robots and from objects that these hold.
        """
        box_limit = self._box_limit.copy()
        mark_allowed_contacts(
            box_limit, self._own.of_entity, self._boxes.columns, allowed
        )
        box_limit[:, list(self._gone)] = SKIP
        self_limit = self._own.limits_within(allowed)
        self._scene = packed(
            self._scene._replace(box_limit=box_limit, self_limit=self_limit)
        )

    def configuration_free(self, q: Array) -> bool:
        """Tell whether the robot may stand at ``q``, shape (n,)."""
        return self._clear(q, q, probing=False, whole=True)

    def motion_free(self, q_a: Array, q_b: Array, *, probing: bool = True) -> bool:
        """Tell whether the whole straight joint-space line from ``q_a`` to ``q_b`` is free.

        Args:
            q_a, q_b: ends, shape (n,).
            probing: whether to check some configurations first, which is faster for motions that are often blocked.
        """
        return self._clear(q_a, q_b, probing=probing, whole=True)

    def seems_free(self, q_a: Array, q_b: Array) -> bool:
        """Tell whether some configurations of the motion are free, shape (n,) each.

        Much cheaper than ``motion_free``, and almost always right on short motions.

        Args:
            q_a: start of the motion, which is not checked.
            q_b: end of the motion.
        """
        return self._clear(q_a, q_b, probing=True, whole=False)

    def _clear(self, q_a: Array, q_b: Array, *, probing: bool, whole: bool) -> bool:
        """Tell whether a motion is clear, as far as ``find_undecided`` decides it."""
        # Writable copies: numba recompiles for read-only arrays.
        q_a, q_b = np.array(q_a, dtype=np.float64), np.array(q_b, dtype=np.float64)
        probes = 0
        while True:
            at, when, what = find_undecided(
                self._scene, q_a, q_b, probing, whole, probes, True
            )
            if at < 0:
                return bool(at == CLEAR)
            for (lo, hi), (kind, body, other) in zip(
                when.tolist(), what.tolist(), strict=True
            ):
                q0, q1 = q_a + lo * (q_b - q_a), q_a + hi * (q_b - q_a)
                mine, solid, limit, together = self._pair(kind, body, other)
                begin = q0 if together else q1
                if may_come_close(
                    mine, q0, q1, solid, begin, q1, limit, together=together
                ):
                    return False
            probes = at + 1

    def contact(self, q: Array) -> Contact | None:
        """Return the closest forbidden contact at ``q``, shape (n,), None where there is none."""
        return min(
            self._contacts(q), key=lambda own: own.distance - own.limit, default=None
        )

    def pairs_in_contact(self, q: Array) -> frozenset[frozenset[str]]:
        """Return the pairs of entities that are in a forbidden contact at ``q``, shape (n,)."""
        return frozenset(
            frozenset((own.moving, own.obstacle)) for own in self._contacts(q)
        )

    def _contacts(self, q: Array) -> Iterator[Contact]:
        """Yield the forbidden contacts at ``q``, shape (n,)."""
        q = np.array(q, dtype=np.float64)
        _, _, what = find_undecided(self._scene, q, q, False, True, 0, False)
        for kind, body, other in what.tolist():
            pair = self._pair(kind, body, other)
            gap, limit = pair.gap_at(q)
            if gap < limit:
                name = pair.other.name
                if kind == BOX:
                    thing = self._boxes.names[other]
                    # Bodies of other robots are named as those of the checked robot.
                    name = f"{thing}:{name}" if "/" in thing else thing
                yield Contact(pair.mine.name, name, gap, limit, pair)

    @property
    def clearance(self) -> float:
        """Clearance to objects that checked motions are proved to keep [m]."""
        return self._to_objects + TOLERANCE

    def tool_comes_within(self, path: Array, name: str, limit: float) -> bool:
        """Tell whether the robot's tool may come nearer to a box at rest than a limit.

        Args:
            path: waypoints of straight joint-space motions, shape (w, n).
            name: name of the fixture or object; an absent one is far away.
            limit: least distance, negative for an allowed overlap [m].
        """
        return any(
            self._tool_comes_within(path, column, limit)
            for column in self._boxes.columns.get(name, ())
        )

    def _tool_comes_within(self, path: Array, column: int, limit: float) -> bool:
        """Tell whether the tool may come nearer to a piece at rest than a limit."""
        box, path = self._boxes.solid(column), np.array(path, dtype=np.float64)
        bodies = self._own.of_entity.get(entity_name(self.robot.name, "tool"), [])
        if not bodies:
            return False
        # In intended contacts, base errors and deviations are ignored.
        solids = [self._own.solids[body].where_planned for body in bodies]
        hulls, box_pose = self._scene.own.hulls, self._scene.box_pose[column]
        half, axes = self._scene.box_half[column], np.zeros((len(bodies), 3))
        for _ in range(_AXES):
            k, s, share = find_unproved(
                hulls, np.array(bodies), axes, path, box_pose, half, limit + _PROVED
            )
            if k < 0:
                return False
            q = path[s] + share * (path[s + 1] - path[s])
            gap, axes[k] = _measure_axis(solids[k], q, box)
            if gap < limit:
                return True
        close = []
        alone = self._only(bodies, column, max(limit, 0.0))
        for q0, q1 in pairwise(path):
            # Pairs that are proved apart keep the limit.
            _, when, what = find_undecided(alone, q0, q1, False, True, 0, False)
            for (lo, hi), (_, body, _) in zip(
                when.tolist(), what.tolist(), strict=True
            ):
                ends = q0 + lo * (q1 - q0), q0 + hi * (q1 - q0)
                close.append((solids[bodies.index(body)], *ends))
        # Ends and middles are cheap to check, and often decide already.
        for solid, q0, q1 in close:
            if any(
                hull_distance_at(solid, q, box, q) < limit
                for q in (q1, 0.5 * (q0 + q1))
            ):
                return True
        return any(
            may_come_close(solid, q0, q1, box, q1, q1, limit, tolerance=_FINE)
            for solid, q0, q1 in close
        )

    def tool_overlaps(self, q: Array, name: str, depth: float) -> BodyPair | None:
        """Return a body of the tool that overlaps a box at rest by more than a depth at ``q``, shape (n,).

        Args:
            q: configuration of the robot.
            name: name of the fixture or object.
            depth: depth of the overlap [m].
        """
        bodies = self._own.of_entity.get(entity_name(self.robot.name, "tool"), [])
        for column, body in product(self._boxes.columns.get(name, ()), bodies):
            mine = self._own.solids[body].where_planned
            pair = BodyPair(mine, self._boxes.solid(column), -depth, together=False)
            if operator.lt(*pair.gap_at(q)):
                return pair
        return None

    def _only(self, bodies: Sequence[int], column: int, limit: float) -> CompiledScene:
        """Return the scene in which only some own bodies are checked, and only against one box."""
        scene = self._scene
        box_limit = np.full_like(scene.box_limit, SKIP)
        box_limit[bodies, column] = limit
        return packed(
            scene._replace(
                box_limit=box_limit,
                self_limit=np.full_like(scene.self_limit, SKIP),
            )
        )

    def _pair(self, kind: int, body: int, other: int) -> BodyPair:
        """Return an own body and its obstacle as a pair."""
        scene, mine = self._scene, self._own.solids[body]
        if kind == BOX:
            limit = float(scene.box_limit[body, other])
            return BodyPair(mine, self._boxes.solid(other), limit, together=False)
        limit = float(scene.self_limit[body, other])
        return BodyPair(mine, self._own.solids[other], limit, together=True)


def _measure_axis(mine: Solid, q: Array, other: Solid) -> tuple[float, Array]:
    """Return the signed distance of a body from one at rest [m], and the axis of it in the frame of the joint.

    The axis is zero where none is found.
    """
    pose, result = place_at_middle(mine, q, q)[0], coal.DistanceResult()
    gap = shape_distance(mine.shape, pose, other.shape, other.at_rest, result)
    turn = np.asarray(pose.getRotation()) @ mine.local[:3, :3].T
    axis = turn.T @ np.asarray(result.normal).reshape(3)
    length = np.linalg.norm(axis)
    known = abs(length - 1.0) < _LENGTH
    return gap, axis if known else np.zeros(3)


def _surroundings(
    cell: Workcell, robot: str, state: WorldState
) -> tuple[Sequence[Held], StandingBoxes]:
    """Return the objects that a robot holds, and all boxes at rest or held by other robots."""
    held, boxes = sort_objects(cell.fixtures, cell.objects, state.attachments)
    for item, at in held:
        if at.holder is not None and at.holder != robot:
            holder = cell.robot(at.holder)
            hand = frame_pose(holder, state.configurations[at.holder])
            there = item.shape.placed(item.name, hand @ at.pose)
            boxes = boxes.plus(there, of_robot=holder)
    around = plus_robots(boxes, cell, robot, state.configurations)
    return objects_held_by(robot, held), around


def plus_robots(
    boxes: StandingBoxes,
    cell: Workcell,
    robot: str,
    configurations: Mapping[str, Array],
) -> StandingBoxes:
    """Return boxes and all robots but one, standing at their configurations."""
    for other in cell.robots:
        if other.name != robot:
            at = np.array(configurations[other.name], dtype=np.float64)
            boxes = boxes.plus(standing_robot(other, at), of_robot=other)
    return boxes
