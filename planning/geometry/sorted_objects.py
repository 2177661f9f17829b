"""Objects at rest and in hands, followed from state to state of a cell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from threading import Lock

import numpy as np

from planning.cell.workcell import Attachment, CellObject, Fixture
from planning.geometry.robot_bodies import Held
from planning.geometry.standing import StandingBoxes, stand_boxes

Sorted = tuple[list[Held], StandingBoxes]
"""The objects that robots hold; fixtures and objects at rest."""

_ABSENT = -1

_MOST = 4
"""So many cells are followed at a time."""


class _SortedObjects:
    """The objects that robots hold, and those at rest, as they were asked for last.

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
        """Tell whether objects are those known here, and others that have come up since."""
        return (
            fixtures is self._fixtures
            and objects[: len(self._objects)] == self._objects
            and not self._still.places.full
        )

    def sort(
        self, objects: tuple[CellObject, ...], where: Mapping[str, Attachment]
    ) -> Sorted:
        """Return the objects that are held, in their order; fixtures and objects at rest."""
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


_FOLLOWED: list[_SortedObjects] = []
_LOCK = Lock()


def sort_objects(
    fixtures: tuple[Fixture, ...],
    objects: tuple[CellObject, ...],
    where: Mapping[str, Attachment],
) -> Sorted:
    """Return the objects that are held, and all boxes at rest.

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
            del _FOLLOWED[: len(_FOLLOWED) + 1 - _MOST]
            _FOLLOWED.append(known)
        return known.sort(objects, where)
