"""Bodies that are exactly boxes, balls, or cylinders in a row on one axis, recognised from their surfaces."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise, permutations, product
from typing import Any, TypeAlias

import numpy as np

from planning.cad.glb_bodies import CadBody
from planning.transforms import Array, Transform, frame_along, identity, translation

EXACT = 2e-6
"""Corners of an exact form are on it to within this [m]: files have seven digits."""

_TURNS = tuple(
    turn
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
    if np.linalg.det(turn := np.array(signs)[:, None] * np.eye(3)[list(order)]) > 0.0
)
"""The 24 turns that map the axes onto the axes."""

_UPSIDE_DOWN: Transform = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class BoxForm:
    """A box of some edge lengths [m], centred at the origin of its frame."""

    size: tuple[float, float, float]

    def match(self, other: ExactForm, within: float) -> Transform | None:
        """Return the pose in the frame of an equal form at which this one covers it; None if they differ."""
        if isinstance(other, BoxForm):
            for turn in _TURNS:
                if self._gap(turn, other.size) <= within:
                    return _turned(identity(), turn)
        return None

    def upright(self, pose: Transform) -> Transform:
        """Return the pose of the same body that is turned least from the axes of the world."""
        kept = (turn for turn in _TURNS if self._gap(turn, self.size) <= EXACT)
        return _turned(pose, _least_turn(pose, kept))

    def aligned(self, pose: Transform) -> tuple[BoxForm, Transform]:
        """Return the form of the same body in the frame that is turned least, and the pose of that."""
        turn = _least_turn(pose, _TURNS)
        x, y, z = (np.abs(turn.T) @ np.array(self.size)).tolist()
        return BoxForm((x, y, z)), _turned(pose, turn)

    def _gap(self, turn: Array, size: tuple[float, float, float]) -> float:
        return float(np.abs(np.abs(turn) @ self.size - size).max())


def _turned(pose: Transform, turn: Array) -> Transform:
    out = pose.copy()
    out[:3, :3] = pose[:3, :3] @ turn
    return out


def _least_turn(pose: Transform, turns: Iterable[Array]) -> Array:
    """Return the turn after which a pose is turned least."""
    return max(turns, key=lambda own: round(float(np.trace(pose[:3, :3] @ own)), 9))


@dataclass(frozen=True)
class RodForm:
    """Cylinders in a row on the z axis of its frame, origin in the middle: radius and length of each, from below [m]."""

    rows: tuple[tuple[float, float], ...]

    @property
    def length(self) -> float:
        """Length of all of them [m]."""
        return sum(length for _, length in self.rows)

    def match(self, other: ExactForm, within: float) -> Transform | None:
        """Return the pose in the frame of an equal form at which this one covers it; None if they differ."""
        if isinstance(other, RodForm) and len(other.rows) == len(self.rows):
            for rows, pose in (
                (self.rows, identity()),
                (self.rows[::-1], _UPSIDE_DOWN),
            ):
                if np.abs(np.array(rows) - np.array(other.rows)).max() <= within:
                    return pose
        return None

    def upright(self, pose: Transform) -> Transform:
        """Return the pose of the same body that is turned least from the axes of the world."""
        axis, sizes = pose[:3, 2], np.array(self.rows)
        leading = axis[np.abs(axis).round(6).argmax()]
        if leading < 0.0 and np.abs(sizes - sizes[::-1]).max() <= EXACT:
            axis = -axis
        # The x axis of the world is kept as far as it can be; along it, z becomes that of the form.
        ahead = np.array([1.0, 0.0, 0.0] if abs(axis[0]) < 0.9 else [0.0, 0.0, -1.0])
        x = ahead - (ahead @ axis) * axis
        x /= np.linalg.norm(x)
        out = pose.copy()
        out[:3, :3] = np.column_stack([x, np.cross(axis, x), axis])
        return out


@dataclass(frozen=True)
class BallForm:
    """A ball of some radius [m], centred at the origin of its frame."""

    radius: float

    def match(self, other: ExactForm, within: float) -> Transform | None:
        """Return the pose in the frame of an equal form at which this one covers it; None if they differ."""
        same = isinstance(other, BallForm) and abs(self.radius - other.radius) <= within
        return identity() if same else None

    def upright(self, pose: Transform) -> Transform:
        """Return the pose of the same body that is turned least from the axes of the world."""
        return translation(*pose[:3, 3])


ExactForm: TypeAlias = BoxForm | RodForm | BallForm


def exact_form(body: CadBody) -> tuple[ExactForm, Transform] | None:
    """Return the form that a body is exactly, and its pose in the body's frame; None if it is none."""
    if len(body.vertices) == 8:
        return _box(body)
    forms = [body.forms[k] if k >= 0 else None for k in np.unique(body.surfaces)]
    known = [form for form in forms if form is not None]
    types = {form["type"] for form in known}
    if len(known) == len(forms) and types == {"sphere"}:
        return _ball(body, known[0])
    if len(known) == len(forms) and types in ({"cylinder"}, {"cylinder", "plane"}):
        return _rod(body, known)
    return None


def _box(body: CadBody) -> tuple[BoxForm, Transform] | None:
    a, b, c = np.moveaxis(body.vertices[body.faces], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    x = normals[0]
    y = normals[np.abs(normals @ x).argmin()]
    left, _, right = np.linalg.svd(np.column_stack([x, y, np.cross(x, y)]))
    pose = identity()
    pose[:3, :3] = left @ right
    local = body.vertices @ pose[:3, :3]
    low, sizes = local.min(axis=0), np.ptp(local, axis=0)
    pose[:3, 3] = pose[:3, :3] @ (low + 0.5 * sizes)
    off = np.abs(np.abs(local - low - 0.5 * sizes) - 0.5 * sizes).max()
    volume = float(np.prod(sizes))
    if off > EXACT or abs(body.volume - volume) > 1e-4 * volume:
        return None
    width, depth, height = (_rounded(size) for size in sizes.tolist())
    return BoxForm((width, depth, height)), pose


def _ball(body: CadBody, form: Mapping[str, Any]) -> tuple[BallForm, Transform] | None:
    centre, radius = np.array(form["center"]), float(form["radius"])
    away = np.linalg.norm(body.vertices - centre, axis=1) - radius
    volume = 4.0 / 3.0 * math.pi * radius**3
    if np.abs(away).max() > EXACT or abs(body.volume - volume) > 0.05 * volume:
        return None
    return BallForm(_rounded(radius)), translation(*centre)


def _rod(
    body: CadBody, forms: list[Mapping[str, Any]]
) -> tuple[RodForm, Transform] | None:
    first = next(form for form in forms if form["type"] == "cylinder")
    origin, axis = np.array(first["origin"]), np.array(first["axis"])
    axis = axis / np.linalg.norm(axis)
    for form in forms:
        along = np.array(form["axis" if form["type"] == "cylinder" else "normal"])
        if np.linalg.norm(np.cross(along, axis)) > 1e-6 * np.linalg.norm(along):
            return None
    high = (body.vertices - origin) @ axis
    out = np.linalg.norm(body.vertices - origin - high[:, None] * axis, axis=1)
    rows = _rows(body, high, out)
    if rows is None:
        return None
    pose = translation(*(origin + 0.5 * (high.min() + high.max()) * axis))
    pose[:3, :3] = frame_along(axis).T
    return RodForm(rows), pose


def _rows(
    body: CadBody, high: Array, out: Array
) -> tuple[tuple[float, float], ...] | None:
    """Return radius and length of the cylinders in a row that a body is, given how high and far out its corners are [m]."""
    levels = np.sort(high)
    levels = levels[np.diff(levels, prepend=-np.inf) > EXACT]
    spans, rows = high[body.faces], list[tuple[float, float]]()
    for low, top in pairwise(levels.tolist()):
        middle = 0.5 * (low + top)
        crossing = (spans.min(axis=1) < middle) & (spans.max(axis=1) > middle)
        radii = out[body.faces[crossing]]
        if not len(radii) or np.ptp(radii) > EXACT:
            return None
        radius, length = _rounded(float(radii.mean())), _rounded(top - low)
        if rows and abs(radius - rows[-1][0]) <= EXACT:
            radius, before = rows.pop()
            length += before
        rows.append((radius, length))
    # The triangles lie within the circles, by less than the sides of their polygons make it.
    volume = sum(math.pi * radius**2 * length for radius, length in rows)
    is_solid = 0.9 * volume < body.volume <= volume * (1.0 + 1e-4)
    return tuple(rows) if is_solid and np.min(rows) > 2.0 * EXACT else None


def _rounded(length: float) -> float:
    """Return a length without the noise of seven digits [m]."""
    return round(length, 7)
