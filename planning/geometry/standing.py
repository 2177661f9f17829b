"""Tables of static obstacles of a robot (boxes, and other robots at rest), shared by many scenes.

An object has the same pose in many scenes. Therefore every pose of an object is stored once, as rows of shared
arrays, and a scene is a selection of rows.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from threading import Lock
from typing import Any

import numpy as np
import numpy.typing as npt

from planning.caches import BoundedCache
from planning.cell.body import ConvexBody
from planning.cell.shape import Placed
from planning.cell.workcell import Attachment, CellObject, Fixture, PlacedRobot
from planning.geometry.exact import Solid, resting_solid
from planning.geometry.hull_table import AT_REST, HullTable
from planning.geometry.robot_bodies import (
    AllowedPairs,
    Held,
    RobotBodies,
    entity_name,
    indices_by_name,
    mark_allowed_contacts,
)
from planning.geometry.swept import SKIP
from planning.kinematics.chain import empty_chain_table
from planning.kinematics.kinematics import joint_poses_of
from planning.packed import packed
from planning.transforms import Array, Indices, Transform, translation

_MOST_PLACES = 50_000
"""Capacity of arrays that scenes share; scenes beyond it begin with new ones."""

_STANDS: BoundedCache[list[Placed]] = BoundedCache(2000)
_ABSENT = -1

_CELLS_AT_A_TIME = 4
"""Number of cells cached at a time."""

_FOLLOWED: list[_SortedObjects] = []
_LOCK = Lock()

_shared_places: _Places | None = None
"""Arrays of the latest scenes."""

Sorted = tuple[list[Held], "StandingBoxes"]
"""The objects that robots hold; fixtures and objects at rest."""


class _Places:
    """Growing arrays with one row per body and pose; rows never change."""

    def __init__(self) -> None:
        self.count = 0
        self.corners_used = 0
        self.pose = np.empty((1024, 4, 4))
        self.half = np.empty((1024, 3))
        self.bounds = np.empty((1024, 6))
        self.joint = np.full(1024, AT_REST, dtype=np.int64)
        self.corner_first = np.zeros(1025, dtype=np.int64)
        self.capsule_first = np.zeros(1025, dtype=np.int64)
        self.corners = np.empty((8192, 3))
        self.most_corners = 0
        self.solids: list[Solid] = []
        self._known: dict[tuple[ConvexBody, bytes], int] = {}
        self._lock = Lock()

    def __getstate__(self) -> dict[str, Any]:
        """Return the state to pickle, without the lock."""
        return {k: v for k, v in vars(self).items() if k != "_lock"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the state, with a new lock."""
        vars(self).update(state, _lock=Lock())

    @property
    def full(self) -> bool:
        """Whether new scenes should begin with arrays of their own."""
        return self.count >= _MOST_PLACES

    def row(self, body: ConvexBody, pose: Transform) -> int:
        """Return the row of a body at a pose."""
        key = body, pose.tobytes()
        known = self._known.get(key)
        if known is None:
            with self._lock:
                known = self._known.get(key)
                if known is None:
                    known = self._known[key] = self._add(body, pose)
        return known

    def _add(self, body: ConvexBody, pose: Transform) -> int:
        row, used = self.count, self.corners_used
        solid = resting_solid(body.name, body, pose)
        corners = solid.vertices
        if row == len(self.pose):
            self.pose, self.half = _doubled(self.pose), _doubled(self.half)
            self.bounds, self.joint = _doubled(self.bounds), np.tile(self.joint, 2)
            none = np.zeros(row, dtype=np.int64)
            self.corner_first = np.append(self.corner_first, none)
            self.capsule_first = np.append(self.capsule_first, none)
        while used + len(corners) > len(self.corners):
            self.corners = _doubled(self.corners)
        half = body.half
        if body.middle is not None:
            pose = pose @ translation(*body.middle.tolist())
        reach = np.abs(pose[:3, :3]) @ half
        self.pose[row] = pose
        self.half[row] = half
        self.bounds[row, :3] = pose[:3, 3] - reach
        self.bounds[row, 3:] = pose[:3, 3] + reach
        self.corners[used : used + len(corners)] = corners
        self.corners_used = used + len(corners)
        self.corner_first[row + 1] = self.corners_used
        self.most_corners = max(self.most_corners, len(corners))
        self.solids.append(solid)
        self.count += 1
        return row


def _doubled(values: Array) -> Array:
    return np.concatenate([values, np.empty_like(values)])


@dataclass(frozen=True)
class StandingBoxes:
    """Convex pieces at rest in the world, and the boxes around them.

    Attributes:
        names: of the fixtures, then of the objects: of each as often as it has pieces. Robots
            that stand are there by their entities.
        rows: of the places of the pieces, in the same order.
        fixtures: how many pieces the fixtures have.
        places: arrays that the rows are of.
        of_robots: names of the entities of other robots, and of what these hold.
        strays: by row, displacement of a piece by the base error of its robot [m].
    """

    names: tuple[str, ...]
    rows: Indices
    fixtures: int
    places: _Places
    of_robots: frozenset[str] = frozenset()
    strays: Mapping[int, float] = field(default_factory=dict)

    @cached_property
    def columns(self) -> Mapping[str, list[int]]:
        """Indices of the pieces of each name."""
        return indices_by_name(self.names)

    @cached_property
    def pose(self) -> Array:
        """Poses of the boxes, shape (b, 4, 4)."""
        return self.places.pose[self.rows]

    @cached_property
    def half(self) -> Array:
        """Half edge lengths, shape (b, 3) [m]."""
        return self.places.half[self.rows]

    @cached_property
    def bounds(self) -> Array:
        """Least and greatest corners, shape (b, 6) [m]."""
        return self.places.bounds[self.rows]

    @cached_property
    def near_robots(self) -> dict[str, tuple[npt.NDArray[np.bool_], StandingBoxes]]:
        """By robot, marks of the pieces of objects that its paths came near to so far, and these pieces."""
        return {}

    @cached_property
    def extended(self) -> dict[Hashable, StandingBoxes]:
        """These pieces and further ones, by what further ones."""
        return {}

    def solid(self, k: int) -> Solid:
        """Return a piece for exact decisions."""
        return self.places.solids[int(self.rows[k])]

    @cached_property
    def hulls(self) -> HullTable:
        """The corners, for compiled code."""
        places = self.places
        table = HullTable(
            empty_chain_table(),
            np.empty((1, 0)),
            np.empty((1, 0)),
            self.rows.astype(np.int32)[None],
            places.joint,
            places.corner_first,
            places.corners,
            places.capsule_first,
            np.empty((0, 2, 3)),
            np.empty(0),
            np.zeros(len(places.joint)),
            places.most_corners,
        )
        return packed(table)

    def first(self, count: int) -> StandingBoxes:
        """Return a number of first boxes, fixtures included."""
        return replace(self, names=self.names[:count], rows=self.rows[:count])

    def without(self, names: Iterable[str]) -> StandingBoxes:
        """Return all boxes but those of some objects."""
        gone = [k for name in names for k in self.columns.get(name, ())]
        if not gone:
            return self
        kept = np.ones(len(self.names), dtype=bool)
        kept[gone] = False
        return self.only(kept[self.fixtures :])

    def only(self, keep: Iterable[bool]) -> StandingBoxes:
        """Return the fixtures and the marked pieces of objects.

        Args:
            keep: one mark a piece.
        """
        chosen = np.flatnonzero(np.asarray(keep)) + self.fixtures
        chosen = np.concatenate([np.arange(self.fixtures), chosen])
        names = self.names
        return replace(
            self,
            names=tuple(names[k] for k in chosen.tolist()),
            rows=self.rows[chosen],
        )

    def plus(
        self,
        boxes: Sequence[Placed],
        *,
        of_robot: PlacedRobot | None = None,
    ) -> StandingBoxes:
        """Return these pieces and further ones.

        Args:
            boxes: the others.
            of_robot: another robot of which they are, or in whose hands.
        """
        if not boxes:
            return self
        rows = [self.places.row(body, pose) for _, body, pose in boxes]
        of_robots, strays = self.of_robots, self.strays
        if of_robot is not None:
            of_robots = of_robots.union(name for name, *_ in boxes)
            if of_robot.base_error:
                off = (_strays(of_robot, body, pose) for _, body, pose in boxes)
                strays = {**strays, **dict(zip(rows, off, strict=True))}
        return StandingBoxes(
            (*self.names, *(name for name, *_ in boxes)),
            np.concatenate([self.rows, np.array(rows, dtype=np.int64)]),
            self.fixtures,
            self.places,
            of_robots,
            strays,
        )


def _strays(robot: PlacedRobot, body: ConvexBody, pose: Transform) -> float:
    """Return the displacement of a standing body by the base error of its robot [m]."""
    points = body.vertices @ pose[:3, :3].T + (pose[:3, 3] - robot.base[:3, 3])
    return robot.base_error.displacement(float(np.linalg.norm(points, axis=1).max()))


def stand_boxes(fixtures: Sequence[Fixture], boxes: Iterable[Placed]) -> StandingBoxes:
    """Return the boxes of fixtures and of the pieces of some objects."""
    global _shared_places
    if _shared_places is None or _shared_places.full:
        _shared_places = _Places()
    places = _shared_places
    still = [piece for f in fixtures for piece in f.shape.placed(f.name, f.pose)]
    empty = StandingBoxes((), np.empty(0, dtype=np.int64), len(still), places)
    return empty.plus([*still, *boxes])


def box_limits(
    own: RobotBodies,
    boxes: StandingBoxes,
    allowed: AllowedPairs,
    to_objects: float,
    to_robots: float,
) -> Array:
    """Return the least distances of a robot's bodies from boxes, SKIP for none, shape (o, b) [m].

    Args:
        own: the bodies. What is bolted down may stand in a fixture.
        boxes: what stands around.
        allowed: unordered pairs of entities that may touch.
        to_objects: from what rests [m].
        to_robots: from other robots and their loads [m].
    """
    limits = np.full((len(own.solids), len(boxes.rows)), to_objects)
    for name in boxes.of_robots:
        of_robot = boxes.columns[name]
        limits[:, of_robot] = to_robots
        for k in of_robot if boxes.strays else ():
            limits[:, k] += boxes.strays.get(int(boxes.rows[k]), 0.0)
    limits[own.hulls.joint < 0, : boxes.fixtures] = SKIP
    mark_allowed_contacts(limits, own.of_entity, boxes.columns, allowed)
    return limits


def standing_robot(robot: PlacedRobot, q: Array) -> list[Placed]:
    """Return the bodies of a standing robot with empty hands, each with its entity."""

    def collect() -> list[Placed]:
        poses = joint_poses_of(robot, q)
        return [
            (entity_name(robot.name, part.group), part.body, poses[part.joint + 1])
            for part in robot.model.parts
        ]

    key = robot.model, robot.name, robot.base.tobytes(), q.tobytes()
    return _STANDS.get(key, collect)


class _SortedObjects:
    """Cached split of objects into held ones and those at rest.

    Robots move far more often than objects, and of these one or two at a time: only what has
    changed hands since is looked at.

    Args:
        fixtures: of the cell.
    """

    def __init__(self, fixtures: tuple[Fixture, ...]) -> None:
        self._fixtures = fixtures
        self._objects: tuple[CellObject, ...] = ()
        self._names: list[str] = []
        self._at: list[Attachment | None] = []
        self._first = [0]
        self._piece_names: list[str] = []
        self._rows = np.empty(0, dtype=np.int64)
        self._held: dict[int, Held] = {}
        self._still = stand_boxes(fixtures, ())
        self._answer: Sorted = [], self._still

    def follows(
        self, fixtures: tuple[Fixture, ...], objects: tuple[CellObject, ...]
    ) -> bool:
        """Tell whether objects are those cached here, plus newly arrived ones."""
        return (
            fixtures is self._fixtures
            and objects[: len(self._objects)] == self._objects
            and not self._still.places.full
        )

    def sort(
        self, objects: tuple[CellObject, ...], where: Mapping[str, Attachment]
    ) -> Sorted:
        """Return the held objects, in their order; fixtures and objects at rest."""
        known = len(self._objects)
        for item in objects[known:]:
            pieces = len(item.shape.pieces)
            self._names.append(item.name)
            self._piece_names += [item.name] * pieces
            self._first.append(self._first[-1] + pieces)
        now = list(map(where.get, self._names))
        if objects is not self._objects or now != self._at:
            self._update(objects, now)
        return self._answer

    def _update(
        self, objects: tuple[CellObject, ...], now: list[Attachment | None]
    ) -> None:
        known = len(self._objects)
        rows = np.full(len(self._piece_names), _ABSENT)
        rows[: len(self._rows)] = self._rows
        before = [*self._at, *[None] * (len(objects) - known)]
        pairs = enumerate(zip(before, now, strict=True))
        for k in [k for k, (was, at) in pairs if was is not at]:
            item, at = objects[k], now[k]
            self._held.pop(k, None)
            own = slice(self._first[k], self._first[k + 1])
            rows[own] = _ABSENT
            if at is not None and at.holder is None:
                places = self._still.places
                rows[own] = [places.row(body, at.pose) for body in item.shape.pieces]
            elif at is not None:
                self._held[k] = item, at
        self._objects, self._at, self._rows = objects, now, rows
        rest = np.flatnonzero(rows != _ABSENT)
        names = tuple(map(self._piece_names.__getitem__, rest.tolist()))
        boxes = replace(
            self._still,
            names=self._still.names + names,
            rows=np.concatenate([self._still.rows, rows[rest]]),
        )
        self._answer = [self._held[k] for k in sorted(self._held)], boxes


def sort_objects(
    fixtures: tuple[Fixture, ...],
    objects: tuple[CellObject, ...],
    where: Mapping[str, Attachment],
) -> Sorted:
    """Return the held objects, and all boxes at rest.

    Args:
        fixtures: of a cell.
        objects: of the cell.
        where: where each object is that is there.
    """
    with _LOCK:
        for known in _FOLLOWED:
            if known.follows(fixtures, objects):
                break
        else:
            known = _SortedObjects(fixtures)
            del _FOLLOWED[: len(_FOLLOWED) + 1 - _CELLS_AT_A_TIME]
            _FOLLOWED.append(known)
        return known.sort(objects, where)
