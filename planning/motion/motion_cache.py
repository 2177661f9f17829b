"""Cache of paths through static scenes, shared between plans.

A path depends on the moving robot and its load, on its ends, and on the obstacles by shape and pose; the
names of the objects, the step and the plan do not matter. A straight path, or a skill, is valid in every
scene whose obstacles were found clear of it; the result of a search is valid in the identical scene only.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field

from planning.caches import BoundedCache
from planning.cell.workcell import Attachment, CellObject, Workcell, WorldState
from planning.errors import TransitError
from planning.tasks.task import Handling
from planning.transforms import Array

Pairs = frozenset[frozenset[str]]
"""Unordered pairs of entities that may touch."""

_MOST_SCENES = 10_000
"""Objects whose shapes are kept: of feeding stations there are others in every plan."""

Polyline = tuple[Array, Array]
"""Waypoints, and the times at which they are passed, from 0 [s]."""

_MOST_ANSWERS = 20_000
"""Capacity in paths; the cache is cleared when it is full."""


@dataclass(frozen=True)
class Scene:
    """Surroundings of a moving robot.

    Attributes:
        obstacles: other robots, held objects, allowed contacts, and objects that change hands.
        standing: all else at rest, by shape and place: a bit for each.
    """

    obstacles: Hashable
    standing: int


class SceneIndex:
    """Index of the shapes and poses of one cell, and the scenes made of them."""

    def __init__(self) -> None:
        self._numbers: dict[Hashable, int] = {}
        self._places: dict[Hashable, int] = {}
        self._shapes: dict[CellObject, int] = {}
        self._objects: tuple[tuple[CellObject, ...], dict[str, CellObject]] = (), {}
        self._rest: tuple[Mapping[str, Attachment], dict[str, int]] = {}, {}

    def scene(
        self,
        cell: Workcell,
        state: WorldState,
        allowed: Sequence[Pairs],
        handlings: Sequence[Handling] = (),
    ) -> Scene:
        """Return the scene of a state.

        Args:
            cell: with all objects.
            state: where everything is at first.
            allowed: allowed contacts, initially and after each change of hands.
            handlings: what changes hands.
        """
        objects, at_rest = self._objects_of(cell), self._at_rest(cell, state)
        special = {n for pairs in allowed for pair in pairs for n in pair}
        special |= {handling.object for handling in handlings}
        special |= state.attachments.keys() - at_rest.keys()
        special &= objects.keys()
        # Objects are distinguished by their poses.
        things = sorted(
            (_place(state.attachments.get(name)), self._shape(objects[name]), name)
            for name in special
        )
        role = {name: f"{k}" for k, (_, _, name) in enumerate(things)}
        obstacles = (
            _joint_values(state.configurations),
            tuple((place, shape) for place, shape, _ in things),
            tuple(
                (role[h.object], h.waypoint, h.holder, h.pose.tobytes())
                for h in handlings
            ),
            tuple(
                frozenset(frozenset(role.get(n, n) for n in pair) for pair in pairs)
                for pairs in allowed
            ),
        )
        standing = 0
        for name, number in at_rest.items():
            if name not in special:
                standing |= 1 << number
        return Scene(obstacles, standing)

    def _objects_of(self, cell: Workcell) -> dict[str, CellObject]:
        if cell.objects is not self._objects[0]:
            self._objects = cell.objects, {item.name: item for item in cell.objects}
        return self._objects[1]

    def _at_rest(self, cell: Workcell, state: WorldState) -> dict[str, int]:
        """Return the numbers of the objects at rest, by their names."""
        if state.attachments is not self._rest[0]:
            objects = self._objects_of(cell)
            found = {
                name: _number(
                    self._places, (self._shape(objects[name]), at.pose.tobytes())
                )
                for name, at in state.attachments.items()
                if at.holder is None
            }
            self._rest = state.attachments, found
        return self._rest[1]

    def _shape(self, item: CellObject) -> int:
        """Return a number shared by objects of the same shape."""
        known = self._shapes.get(item)
        if known is None:
            if len(self._shapes) >= _MOST_SCENES:
                self._shapes.clear()
            corners = tuple(p.vertices.tobytes() for p in item.shape.pieces)
            known = _number(self._numbers, (item.kind, corners))
            self._shapes[item] = known
        return known


def _number(numbers: dict[Hashable, int], thing: Hashable) -> int:
    return numbers.setdefault(thing, len(numbers))


def _joint_values(configurations: Mapping[str, Array]) -> Hashable:
    return tuple((name, q.tobytes()) for name, q in configurations.items())


def _place(at: Attachment | None) -> tuple[str, bytes]:
    return ("absent", b"") if at is None else (at.holder or "", at.pose.tobytes())


@dataclass(frozen=True)
class CachedPath:
    """A path, and whether it depends on nothing but being free."""

    path: Polyline
    plain: bool


@dataclass(frozen=True)
class MotionCache:
    """Paths found for plans of one cell with the same settings.

    A path that only has to be clear is stored with all obstacles that it was found to be clear of.

    Attributes:
        scenes: the scenes they lead through.
    """

    scenes: SceneIndex = field(default_factory=SceneIndex)
    _clear: dict[Hashable, tuple[Polyline, int]] = field(default_factory=dict)
    _found: BoundedCache[Polyline | TransitError] = field(
        default_factory=lambda: BoundedCache(_MOST_ANSWERS)
    )

    def path(
        self,
        moving: Hashable,
        scene: Scene,
        seed: int,
        work_out: Callable[[], CachedPath],
    ) -> Polyline:
        """Return a path, computed unless it is cached.

        Args:
            moving: what moves, and through what.
            scene: its surroundings.
            seed: of the search for it.
            work_out: finds it.

        Raises:
            TransitError: there is none, or none was found in this scene before.
        """
        alike = moving, scene.obstacles
        clear = self._clear.get(alike)
        if clear is not None and scene.standing & ~clear[1] == 0:
            return clear[0]

        def ask() -> Polyline | TransitError:
            try:
                found = work_out()
            except TransitError as error:
                # A copy, as an error that was raised keeps its whole stack.
                return copy(error)
            if found.plain:
                self._note_clear(alike, found.path, scene.standing)
            return found.path

        known = self._found.get((moving, scene, seed), ask)
        if isinstance(known, TransitError):
            raise copy(known)
        return known

    def _note_clear(self, alike: Hashable, path: Polyline, of: int) -> None:
        known = self._clear.get(alike)
        if known is None and len(self._clear) >= _MOST_ANSWERS:
            self._clear.clear()
        self._clear[alike] = path, of if known is None else known[1] | of
