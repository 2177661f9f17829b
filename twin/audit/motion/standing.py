"""Fixtures and objects at rest, kept from stretch to stretch: only what changes hands is worked out anew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planning.transforms import Array, Transform
from twin.audit.motion.executed import ObjectRow
from twin.audit.motion.tracks import Track
from twin.audit.worlds.world import AuditWorld, Shape

_STILL = np.zeros((0, 1))


@dataclass(frozen=True)
class RestingBoxes:
    """Fixtures, and objects at rest.

    Attributes:
        tracks: of the shapes of the fixtures, then of the objects.
        centre: of the shapes, shape (b, 3) [m].
        reach: half edges of the upright boxes around them, shape (b, 3) [m].
        radius: of the spheres around them, shape (b,) [m].
    """

    tracks: Sequence[Track]
    centre: Array
    reach: Array
    radius: Array


class StandingTable:
    """Table of the fixtures, and of the objects that are at rest now.

    Args:
        world: the cell.
    """

    def __init__(self, world: AuditWorld) -> None:
        shapes = [*world.fixtures, *world.objects]
        self._shapes: dict[str, list[tuple[int, Shape]]] = {}
        for k, shape in enumerate(shapes):
            self._shapes.setdefault(shape.entity, []).append((k, shape))
        self._tracks: list[Track | None] = [None] * len(shapes)
        self._centre = np.zeros((len(shapes), 3))
        self._reach = np.zeros((len(shapes), 3))
        self._radius = np.array([shape.radius for shape in shapes])
        for item in world.cell.fixtures:
            for k, shape in self._shapes[item.name]:
                self._put(k, shape, shape.at(item.pose))

    def put(self, row: ObjectRow) -> None:
        """Take over where an object is from now on."""
        for k, shape in self._shapes[row.object]:
            if row.holder is None:
                self._put(k, shape, shape.at(row.pose))
            else:
                self._tracks[k] = None

    def boxes(self) -> RestingBoxes:
        """Return what stands now."""
        there = [k for k, track in enumerate(self._tracks) if track is not None]
        return RestingBoxes(
            [track for track in self._tracks if track is not None],
            self._centre[there],
            self._reach[there],
            self._radius[there],
        )

    def _put(self, k: int, shape: Shape, pose: Transform) -> None:
        rotation, centre = pose[None, :3, :3], pose[None, :3, 3]
        reach = np.abs(rotation) @ shape.half
        self._tracks[k] = Track(
            shape, None, 0, rotation, centre, rotation, reach, _STILL, pose
        )
        self._centre[k], self._reach[k] = centre[0], reach[0]
