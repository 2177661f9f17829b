"""Distances and contacts of objects and fixtures at rest, measured between their convex pieces.

Used by assemblies of parts, by constructions, and by checks before planning.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np

from planning.cell.workcell import CellObject, Fixture, Workcell
from planning.geometry.exact import Solid, hull_distance, place_at_middle, resting_solid
from planning.transforms import Array, Transform

PlacedObject = tuple[CellObject | Fixture, Transform]
"""An object or fixture, and the pose of its frame in the world."""

_NOWHERE = np.zeros(0)
"""Empty configuration, for objects that no robot carries."""

TOUCH = 0.03
"""Greatest gap between parts that count as touching, which allows joints with clearance [m]."""

NEAR = 0.002
"""Greatest gap in a contact, to allow for rounding and for the margin of planning [m]."""


def nearby_entities(
    part: PlacedObject, others: Mapping[str, PlacedObject], within: float
) -> dict[str, float]:
    """Return the entities near a part, with their distances.

    Args:
        part: where it lies.
        others: everything else, by name.
        within: what is further away than this is left out [m].

    Returns:
        Signed distances by name, negative for overlap [m].
    """
    low, high = bounding_corners(part)
    out = {}
    for name, other in others.items():
        other_low, other_high = bounding_corners(other)
        if np.any(low > other_high + within) or np.any(other_low > high + within):
            continue
        gap = _gap(part, other)
        if gap <= within:
            out[name] = gap
    return out


def nearest_entity(
    part: PlacedObject, others: Mapping[str, PlacedObject]
) -> tuple[str, float] | None:
    """Return the entity nearest to a part and its distance [m]; None where there is no other."""
    low, high = bounding_corners(part)
    least = {
        name: float(np.linalg.norm(np.maximum(np.maximum(low - b, a - high), 0.0)))
        for name, (a, b) in (
            (k, bounding_corners(other)) for k, other in others.items()
        )
    }
    best: tuple[str, float] | None = None
    for name in sorted(others, key=least.__getitem__):
        if best is not None and least[name] > best[1]:
            break
        gap = _gap(part, others[name])
        if best is None or gap < best[1]:
            best = name, gap
    return best


def describe_nearest(
    name: str, part: PlacedObject, others: Mapping[str, PlacedObject]
) -> str:
    """Return in words the thing nearest to a part, and its distance."""
    found = nearest_entity(part, others)
    if found is None:
        return f"nothing else is there by then to be near {name}"
    away = f"{found[1] * 1e3:.1f} mm away" if found[1] > 5e-5 else "which it touches"
    return f"nearest to {name} is {found[0]}, {away}"


def _gap(one: PlacedObject, other: PlacedObject) -> float:
    """Return the signed distance of the nearest two pieces, the deepest overlap if any [m]."""
    pairs = product(_solids(one), _solids(other))
    return min(
        hull_distance(a, pose_a, b, pose_b) for (a, pose_a), (b, pose_b) in pairs
    )


def _solids(placed: PlacedObject) -> list[tuple[Solid, Any]]:
    """Return the pieces of a placed thing, each with its pose for coal."""
    item, pose = placed
    found = [resting_solid(item.name, body, pose) for body in item.shape.pieces]
    return [(solid, place_at_middle(solid, _NOWHERE, _NOWHERE)[0]) for solid in found]


def standing_fixtures(cell: Workcell) -> dict[str, PlacedObject]:
    """Return the fixtures of a cell at their poses, by name."""
    return {item.name: (item, item.pose) for item in cell.fixtures}


def lowest_height(placed: PlacedObject) -> float:
    """Return the height of the lowest corner of a placed thing [m]."""
    return float(bounding_corners(placed)[0][2])


def bounding_corners(placed: PlacedObject) -> tuple[Array, Array]:
    """Return the axis-aligned bounding box of a placed thing, least and greatest corner [m]."""
    item, pose = placed
    return item.shape.bounds(pose)
