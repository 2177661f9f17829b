"""Contacts of a part where it lies, found from the geometry."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from planning.cell.workcell import CellObject, Fixture, Workcell
from planning.geometry.exact import distance, place, resting_solid
from planning.transforms import Array, Transform

Lying = tuple[CellObject | Fixture, Transform]
"""A box and the pose of its centre in the world."""

_NOWHERE = np.zeros(0)
"""Configuration of what no robot carries."""


def near_to(
    part: Lying, others: Mapping[str, Lying], within: float
) -> dict[str, float]:
    """Return the entities near a part, with their distances.

    Args:
        part: where it lies.
        others: everything else, by name.
        within: what is further away than this is left out [m].

    Returns:
        Signed distances by name, negative for overlap [m].
    """
    low, high = _bounds(part)
    mine = resting_solid("part", part[0].body, part[1])
    out = {}
    for name, other in others.items():
        other_low, other_high = _bounds(other)
        if np.any(low > other_high + within) or np.any(other_low > high + within):
            continue
        theirs = resting_solid(name, other[0].body, other[1])
        gap = distance(
            mine,
            place(mine, _NOWHERE, _NOWHERE)[0],
            theirs,
            place(theirs, _NOWHERE, _NOWHERE)[0],
        )
        if gap <= within:
            out[name] = gap
    return out


def standing(cell: Workcell) -> dict[str, Lying]:
    """Return the fixtures of a cell where they stand, by name."""
    return {item.name: (item, item.pose) for item in cell.fixtures}


def lowest(lying: Lying) -> float:
    """Return the height of the lowest corner of what lies somewhere [m]."""
    return float(_bounds(lying)[0][2])


def _bounds(lying: Lying) -> tuple[Array, Array]:
    item, pose = lying
    reach = np.abs(pose[:3, :3]) @ (0.5 * np.asarray(item.size))
    return pose[:3, 3] - reach, pose[:3, 3] + reach
