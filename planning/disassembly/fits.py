"""Fits of bodies: round pins in bores, and tongues in slots, with their clearance."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from planning.disassembly.blocking import DEEPEST_PRESS, Blocking
from planning.disassembly.body import Surface
from planning.disassembly.surface_contacts import Patches
from planning.statics.contact_patch import ContactPatch
from planning.transforms import Array, Indices, frame_along

LOOSEST = 5e-4
"""Greatest clearance of a fit [m]."""

_SMOOTH = math.radians(40.0)
"""Facets that are turned from each other by less approximate a rounding."""

_LOOSE = 3e-3
"""A pin with greater play counts as beside its bore [m]."""

_ROUND = 2e-5, 2e-3
"""Corners of a round surface are on one circle to within this [m], or this share of its radius."""

_BESIDE = 0.02
"""Greatest cosine of the normals of a round surface with its axis."""

_WIDEST_GAP = math.radians(160.0)
"""A round surface that is open on a wider arc is a rounding, not a pin or a bore."""

_PARALLEL = 1e-3
"""Axes, and normals of slots, that differ by less are parallel."""


@dataclass(frozen=True)
class BodyFit:
    """Two bodies that fit into each other.

    Attributes:
        kind: ``pin in bore``, ``tongue in slot``, or ``overlap`` where they are in each other otherwise.
        bodies: names of the inner and the outer one.
        clearance_m: play on each side with the inner one in the middle, half the difference of diameters or
            widths; negative for a press fit.
        tolerance_m: uncertainty of the clearance, as the surfaces are tessellated.
    """

    kind: str
    bodies: tuple[str, str]
    clearance_m: float
    tolerance_m: float

    @property
    def words(self) -> str:
        """Description for people: ``pin in bore: 0.05 mm``."""
        size = f"{1e3 * abs(self.clearance_m):.2f} mm"
        return f"{self.kind}: {size}{' pressed' if self.clearance_m < 0.0 else ''}"


@dataclass(frozen=True)
class _Round:
    """Round surface of a body, from a low to a high end along its axis."""

    axis: Array
    centre: Array
    radius: float
    off: float
    low: float
    high: float
    hollow: bool


def find_fits(blocking: Blocking, patches: Patches) -> tuple[BodyFit, ...]:
    """Return the fits of all pairs of bodies, given their contacts, of slots as far as their sides touch."""
    rounds = {name: list(_rounds(own)) for name, own in blocking.surfaces.items()}
    found: dict[tuple[str, str, str, int], BodyFit] = {}
    for inner, outer in permutations(blocking.names, 2):
        if not blocking.near(inner, outer, LOOSEST):
            continue
        pairs = [
            (pin, bore)
            for pin in rounds[inner]
            for bore in rounds[outer]
            if bore.hollow and not pin.hollow and _is_inside(pin, bore)
        ]
        for pin, bore in pairs:
            play, off = bore.radius - pin.radius, bore.off + pin.off
            if play <= LOOSEST + off:
                key = inner, outer, "pin", round(pin.radius * 1e6)
                fit = BodyFit("pin in bore", (inner, outer), play, off)
                found.setdefault(key, fit)
        sign = 1.0 if (inner, outer) in patches else -1.0
        own = patches.get((inner, outer) if sign > 0.0 else (outer, inner), ())
        for play, normal in _slots(own, sign):
            if all(abs(float(pin.axis @ normal)) > _BESIDE for pin, _ in pairs):
                key = inner, outer, "slot", round(play * 1e6)
                fit = BodyFit("tongue in slot", (inner, outer), play, 1e-6)
                found.setdefault(key, fit)
    listed = {frozenset(fit.bodies) for fit in found.values()}
    for pair, deep in blocking.pressed.items():
        if pair not in listed:
            one, other = sorted(pair, key=blocking.names.index)
            fit = BodyFit("overlap", (one, other), -0.75 * deep, 0.25 * deep)
            found[one, other, "overlap", 0] = fit
    return tuple(found.values())


def _is_inside(pin: _Round, bore: _Round) -> bool:
    """Return whether a pin is in a bore, on its axis as far as its play tells."""
    play, cosine = bore.radius - pin.radius, float(pin.axis @ bore.axis)
    if not -DEEPEST_PRESS < play < _LOOSE or abs(cosine) < 1.0 - _PARALLEL**2:
        return False
    between = pin.centre - bore.centre
    along = float(between @ bore.axis)
    off = float(np.linalg.norm(between - along * bore.axis))
    ends = sorted(cosine * z for z in (pin.low, pin.high))
    deep = min(bore.high, along + ends[1]) - max(bore.low, along + ends[0])
    return off < abs(play) + 1e-4 and deep > 0.0


def _slots(
    patches: tuple[ContactPatch, ...], sign: float
) -> Iterator[tuple[float, Array]]:
    """Yield the clearance, and the normal, of pairs of faces between which the inner body is."""
    for one, other in combinations(patches, 2):
        normal, play = sign * one.normal, 0.5 * (one.gap + other.gap)
        between = one.points.mean(axis=0) - other.points.mean(axis=0)
        opposite = float(one.normal @ other.normal) <= _PARALLEL**2 - 1.0
        faces = opposite and between @ normal > 0.0 and _overlap(one, other)
        if faces and play < LOOSEST:
            yield play, normal


def _overlap(one: ContactPatch, other: ContactPatch) -> bool:
    """Return whether two contacts are opposite each other, at least in part."""
    across = frame_along(one.normal)[:2]
    a, b = one.points @ across.T, other.points @ across.T
    low = np.maximum(a.min(axis=0), b.min(axis=0))
    return bool(np.all(low < np.minimum(a.max(axis=0), b.max(axis=0))))


def _rounds(surface: Surface) -> Iterator[_Round]:
    """Yield the round surfaces of a body: smooth parts that are cylinders, all around."""
    from trimesh.graph import connected_components

    smooth = surface.pairs[surface.bends < _SMOOTH]
    for own in connected_components(smooth, min_len=8):
        if (found := _round(surface, own)) is not None:
            yield found


def _round(surface: Surface, own: Indices) -> _Round | None:
    corners = surface.vertices[surface.faces[own]]
    normals = surface.normals[own]
    axis = np.linalg.svd(normals, full_matrices=False)[2][-1]
    if np.abs(normals @ axis).max() > _BESIDE:
        return None
    across = frame_along(axis)[:2]
    points = corners.reshape(-1, 3)
    flat = points @ across.T
    rows = np.column_stack([2.0 * flat, np.ones(len(flat))])
    (x, y, rest), *_ = np.linalg.lstsq(rows, (flat**2).sum(axis=1), rcond=None)
    radius = math.sqrt(max(rest + x * x + y * y, 0.0))
    away = flat - (x, y)
    off = float(np.abs(np.linalg.norm(away, axis=1) - radius).max())
    if off > max(_ROUND[0], _ROUND[1] * radius):
        return None
    turns = np.sort(np.arctan2(away[:, 1], away[:, 0]))
    if float(np.diff(turns, append=turns[0] + 2.0 * math.pi).max()) > _WIDEST_GAP:
        return None
    centre = across.T @ (x, y)
    heights = points @ axis
    middle = corners.mean(axis=1) - centre
    hollow = float(np.einsum("nx,nx->", normals @ across.T, middle @ across.T)) < 0.0
    low, high = float(heights.min()), float(heights.max())
    return _Round(axis, centre, radius, off, low, high, hollow)
