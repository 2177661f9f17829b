"""Play (clearance) of a part in its place, across its insertion direction, and the probability of a fit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from planning.cell.shape import Cylinder, Element, Mesh, Shape
from planning.contacts.interference import (
    SNUG,
    bore_around,
    format_depth,
    forms_overlap_depth,
    overlap_depth,
)
from planning.contacts.surface_gap import free_distance, surface_gap
from planning.contacts.touching import PlacedObject, bounding_corners
from planning.transforms import Array, Transform, read_only_copy, translation

_LIFT = 1e-4
"""Distance by which a part is lifted while play is measured, so that its supports do not count [m]."""

_DIRECTIONS = 32
"""Directions around the insertion path, in which the play is measured."""

_EXACT = 1e-6
"""Play that no formula gives is found to within this [m]."""

_FREE = 1e-6
"""Deeper than this a part is in something [m]."""

ISO_9283 = 2.0 * math.sqrt(2.0 / math.pi) + 3.0 * math.sqrt(3.0 - 8.0 / math.pi)
"""Repeatability of positioning (ISO 9283) over the standard deviation of each coordinate: it is the
mean distance from the mean position plus three of its standard deviations, of a Maxwell distribution."""


@dataclass(frozen=True)
class Play:
    """Play of a part in its place across its insertion direction.

    Attributes:
        free: how far it can go in each direction around the way until it meets something, shape (d,);
            infinite beyond ``SNUG`` [m].
        guides: names of the things that guide it.
        pressed: interference of a press fit, 0 where it has play [m].
    """

    free: Array
    guides: tuple[str, ...]
    pressed: float = 0.0

    @property
    def least(self) -> float:
        """The least play [m]."""
        return float(self.free.min())

    @property
    def words(self) -> str:
        """Description for people: ``0.21 mm on all sides``."""
        if self.pressed > 0.0:
            return f"pressed in by {format_depth(self.pressed)}"
        if not np.isfinite(self.free).all():
            both = self.free + np.roll(self.free, _DIRECTIONS // 2)
            return f"{_fine(both.min())} from side to side"
        even = self.free.max() < 1.5 * self.least + 2e-5
        return f"{'' if even else 'at least '}{_fine(self.least)} on all sides"

    def chance(self, repeatability: float) -> float | None:
        """Return the probability that a part fits into its place; None for a press fit.

        Positions are normally distributed around the nominal one, alike in every direction.

        Args:
            repeatability: of positioning, as ISO 9283 has it [m].
        """
        if self.pressed > 0.0:
            return None
        if repeatability == 0.0:
            return 1.0
        spread = repeatability / ISO_9283
        return float(-np.expm1(-0.5 * (self.free / spread) ** 2).mean())


def _fine(distance: float) -> str:
    """Return a play in words, below a tenth of a millimetre to the micrometre."""
    return f"{1e3 * distance:.{3 if distance < 9.9e-5 else 2}f} mm"


def play_in_place(
    part: PlacedObject, others: Mapping[str, PlacedObject], insertion: Array
) -> Play | None:
    """Return the play of a part in its place, None where nothing guides it.

    It is guided where no quarter of all directions is free by more than ``SNUG``: not in a corner.

    Args:
        part: in its place.
        others: what is there, by name.
        insertion: direction of its insertion path, of length one.
    """
    item, pose = part
    lifted = translation(*(-_LIFT * insertion)) @ pose
    low, high = bounding_corners((item, lifted))
    free = np.full(_DIRECTIONS, np.inf)
    pressed, guides = 0.0, []
    for name, other in others.items():
        other_low, other_high = bounding_corners(other)
        if np.any(low > other_high + SNUG) or np.any(other_low > high + SNUG):
            continue
        deep = overlap_depth((item, lifted), other)
        if deep > _FREE:
            pressed = max(pressed, deep)
            own = np.zeros(_DIRECTIONS)
        else:
            own = _free(item.shape, lifted, other, insertion)
        if np.isfinite(own).any():
            guides.append(name)
            free = np.minimum(free, own)
    quarter = [np.roll(free, k) for k in range(_DIRECTIONS // 4)]
    if np.isinf(np.min(quarter, axis=0)).any():
        return None
    return Play(read_only_copy(free), tuple(sorted(guides)), pressed)


def _free(
    shape: Shape, pose: Transform, other: PlacedObject, insertion: Array
) -> Array:
    """Return the free travel of a part across its insertion direction until it meets one thing, shape (d,) [m]."""
    out = np.full(_DIRECTIONS, np.inf)
    thing, there = other
    for own, met in product(shape.elements, thing.shape.elements):
        a = Element(own.form, pose @ own.pose)
        b = Element(met.form, there @ met.pose)
        found = _free_in_bore(a, b, insertion, 1.0)
        if found is None:
            found = _free_in_bore(b, a, insertion, -1.0)
        if found is None:
            found = _free_of_surface(a, b, insertion)
        if found is None:
            found = _free_by_steps(a, b, insertion)
        out = np.minimum(out, found)
    return np.where(out > SNUG, np.inf, out)


def _free_in_bore(
    peg: Element, mesh: Element, insertion: Array, sign: float
) -> Array | None:
    """Return the free travel of a round peg in the bore of a mesh, None where it is in none."""
    if not isinstance(peg.form, Cylinder) or not isinstance(mesh.form, Mesh):
        return None
    axis = peg.pose[:3, 2]
    if abs(float(axis @ insertion)) < 1.0 - 1e-6:
        return None
    bore = bore_around(peg.form, peg.pose, mesh)
    if bore is None:
        return None
    room = bore.radius - peg.form.radius
    centre = peg.pose[:3, :2] @ bore.centre
    directions = sign * _across(insertion)
    along = directions @ centre
    # Where a ray from the nominal place leaves the circle in which the axis of the peg may be.
    rest = room * room - float(centre @ centre) + along * along
    return np.asarray(np.maximum(along + np.sqrt(np.maximum(rest, 0.0)), 0.0))


def _free_of_surface(one: Element, other: Element, insertion: Array) -> Array | None:
    """Return the free travel of a mesh until its surface meets that of another, shape (d,) [m].

    Returns:
        None where one of the two is no mesh, or they meet at once.
    """
    if surface_gap(one, other) == 0.0:
        return None
    return np.array(
        [free_distance(one, other, direction, SNUG) for direction in _across(insertion)]
    )


def _free_by_steps(one: Element, other: Element, insertion: Array) -> Array:
    """Return the free travel of a form until it meets another one, by bisection, shape (d,) [m]."""

    def deep(direction: Array) -> float:
        moved = Element(one.form, read_only_copy(translation(*direction) @ one.pose))
        return forms_overlap_depth(moved, other)

    out = np.full(_DIRECTIONS, np.inf)
    for k, direction in enumerate(_across(insertion)):
        probe, low, high = SNUG, 0.0, SNUG
        while high - low > _EXACT:
            found = deep(probe * direction)
            if found <= _FREE:
                low = probe
            else:  # on the retreat it is free no sooner
                high = max(probe - found, low)
            straight = low == 0.0 and probe == SNUG
            probe = high - _EXACT if straight else 0.5 * (low + high)
        out[k] = np.inf if low == SNUG else low
    return out


def _across(insertion: Array) -> Array:
    """Return directions perpendicular to a displacement, evenly around it, shape (d, 3)."""
    least = np.eye(3)[np.argmin(np.abs(insertion))]
    x = np.cross(insertion, least)
    x /= np.linalg.norm(x)
    y = np.cross(insertion, x)
    angle = 2.0 * math.pi / _DIRECTIONS * np.arange(_DIRECTIONS)
    return np.asarray(np.outer(np.cos(angle), x) + np.outer(np.sin(angle), y))
