"""Bodies that are exactly boxes, balls, or cylinders in a row on one axis, recognised from their surfaces."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise, permutations, product
from typing import Any, TypeAlias

import numpy as np

from planning.cad.glb_bodies import CadBody
from planning.transforms import Array, Transform, translation

EXACT = 2e-6
"""Corners of an exact form are on it to within this [m]: files have seven digits."""

_TURNS = tuple(
    np.array(signs)[:, None] * np.eye(3)[list(order)]
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
    if np.linalg.det(np.array(signs)[:, None] * np.eye(3)[list(order)]) > 0.0
)
"""The 24 turns that map the axes onto the axes."""

_UPSIDE_DOWN: Transform = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class BoxForm:
    """A box, centred at the origin of its frame.

    Attributes:
        size: edge lengths [m].
    """

    size: tuple[float, float, float]

    def match(self, other: ExactForm, within: float) -> Transform | None:
        """Return the pose in the frame of an equal form at which this one covers it; None if they differ."""
        if not isinstance(other, BoxForm):
            return None
        for turn in _TURNS:
            sizes = np.abs(turn) @ np.array(self.size)
            if np.abs(sizes - other.size).max() <= within:
                pose = np.eye(4)
                pose[:3, :3] = turn
                return pose
        return None

    def upright(self, pose: Transform) -> Transform:
        """Return the pose of the same body that is turned least from the axes of the world."""
        turned = [pose[:3, :3] @ turn for turn in _TURNS if self._keeps(turn)]
        out = pose.copy()
        out[:3, :3] = max(turned, key=lambda turn: round(float(np.trace(turn)), 9))
        return out

    def aligned(self, pose: Transform) -> tuple[BoxForm, Transform]:
        """Return the form of the same body in the frame that is turned least, and the pose of that."""
        turn = max(
            _TURNS, key=lambda own: round(float(np.trace(pose[:3, :3] @ own)), 9)
        )
        out = pose.copy()
        out[:3, :3] = pose[:3, :3] @ turn
        x, y, z = (np.abs(turn.T) @ np.array(self.size)).tolist()
        return BoxForm((x, y, z)), out

    def _keeps(self, turn: Array) -> bool:
        return bool(np.allclose(np.abs(turn) @ self.size, self.size, atol=EXACT))


@dataclass(frozen=True)
class RodForm:
    """Cylinders in a row on the z axis of its frame, whose origin is in the middle.

    Attributes:
        rows: radius and length of each, from below [m].
    """

    rows: tuple[tuple[float, float], ...]

    @property
    def length(self) -> float:
        """Length of all of them [m]."""
        return sum(length for _, length in self.rows)

    def match(self, other: ExactForm, within: float) -> Transform | None:
        """Return the pose in the frame of an equal form at which this one covers it; None if they differ."""
        if not isinstance(other, RodForm) or len(other.rows) != len(self.rows):
            return None
        for rows, pose in ((self.rows, np.eye(4)), (self.rows[::-1], _UPSIDE_DOWN)):
            if np.abs(np.array(rows) - np.array(other.rows)).max() <= within:
                return pose
        return None

    def aligned(self, pose: Transform) -> tuple[RodForm, Transform]:
        """Return the form, and the pose of the same body that is turned least."""
        return self, self.upright(pose)

    def upright(self, pose: Transform) -> Transform:
        """Return the pose of the same body that is turned least from the axes of the world."""
        axis = pose[:3, 2]
        sizes = np.array(self.rows)
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
    """A ball, centred at the origin of its frame.

    Attributes:
        radius: of it [m].
    """

    radius: float

    def match(self, other: ExactForm, within: float) -> Transform | None:
        """Return the pose in the frame of an equal form at which this one covers it; None if they differ."""
        if isinstance(other, BallForm) and abs(self.radius - other.radius) <= within:
            return np.eye(4)
        return None

    def aligned(self, pose: Transform) -> tuple[BallForm, Transform]:
        """Return the form, and the pose of the same body that is not turned."""
        return self, self.upright(pose)

    def upright(self, pose: Transform) -> Transform:
        """Return the pose of the same body that is not turned."""
        return translation(*pose[:3, 3])


ExactForm: TypeAlias = BoxForm | RodForm | BallForm


def exact_form(body: CadBody) -> tuple[ExactForm, Transform] | None:
    """Return the form that a body is exactly, and its pose in the body's frame; None if it is none."""
    return _box(body) or _ball(body) or _rod(body)


def _box(body: CadBody) -> tuple[BoxForm, Transform] | None:
    if len(body.vertices) != 8:
        return None
    corner = body.vertices[0]
    others = body.vertices[1:] - corner
    # The three nearest corners of a box need not be those along its edges.
    for chosen in permutations(range(7), 3):
        edges = others[list(chosen)]
        sizes = np.linalg.norm(edges, axis=1)
        axes = edges / sizes[:, None]
        if np.abs(axes @ axes.T - np.eye(3)).max() > 1e-5:
            continue
        if np.linalg.det(axes) < 0.0:
            continue
        pose = np.eye(4)
        pose[:3, :3] = _nearest_rotation(axes.T)
        pose[:3, 3] = corner + 0.5 * edges.sum(axis=0)
        local = np.abs((body.vertices - pose[:3, 3]) @ pose[:3, :3])
        if np.abs(local - 0.5 * sizes).max() <= EXACT:
            if abs(body.volume - float(np.prod(sizes))) > 1e-4 * float(np.prod(sizes)):
                return None
            x, y, z = (_rounded(size) for size in sizes.tolist())
            return BoxForm((x, y, z)), pose
    return None


def _nearest_rotation(axes: Array) -> Array:
    left, _, right = np.linalg.svd(axes)
    return np.asarray(left @ right)


def _ball(body: CadBody) -> tuple[BallForm, Transform] | None:
    forms = list(_own_forms(body))
    if not forms or any(form is None or form["type"] != "sphere" for form in forms):
        return None
    first = forms[0]
    assert first is not None
    centre, radius = np.array(first["center"]), float(first["radius"])
    away = np.linalg.norm(body.vertices - centre, axis=1) - radius
    volume = 4.0 / 3.0 * math.pi * radius**3
    if np.abs(away).max() > EXACT or abs(body.volume - volume) > 0.05 * volume:
        return None
    return BallForm(_rounded(radius)), translation(*centre)


def _rod(body: CadBody) -> tuple[RodForm, Transform] | None:
    """Return the cylinders in a row that a body is made of."""
    forms = list(_own_forms(body))
    if not forms or any(
        form is None or form["type"] not in ("plane", "cylinder") for form in forms
    ):
        return None
    round_ones = [form for form in forms if form and form["type"] == "cylinder"]
    if not round_ones:
        return None
    origin, axis = np.array(round_ones[0]["origin"]), np.array(round_ones[0]["axis"])
    axis = axis / np.linalg.norm(axis)
    for form in forms:
        assert form is not None
        along = np.array(form["axis" if form["type"] == "cylinder" else "normal"])
        if np.linalg.norm(np.cross(along, axis)) > 1e-6 * np.linalg.norm(along):
            return None
    high = (body.vertices - origin) @ axis
    out = np.linalg.norm(body.vertices - origin - high[:, None] * axis, axis=1)
    rows = _rows(body, high, out)
    if rows is None:
        return None
    pose = np.eye(4)
    x = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    x /= np.linalg.norm(x)
    pose[:3, :3] = np.column_stack([x, np.cross(axis, x), axis])
    pose[:3, 3] = origin + 0.5 * (high.min() + high.max()) * axis
    return RodForm(rows), pose


def _rows(
    body: CadBody, high: Array, out: Array
) -> tuple[tuple[float, float], ...] | None:
    """Return radius and length of the cylinders in a row whose surface triangles are.

    Args:
        body: the body.
        high: of its corners along the axis [m].
        out: distance of its corners from the axis [m].
    """
    levels = _levels(high)
    rows: list[tuple[float, float]] = []
    for low, top in pairwise(levels):
        middle = 0.5 * (low + top)
        spans = high[body.faces]
        crossing = (spans.min(axis=1) < middle) & (spans.max(axis=1) > middle)
        radii = out[body.faces[crossing]]
        if not len(radii) or np.ptp(radii) > EXACT:
            return None
        rows.append((_rounded(float(radii.mean())), _rounded(top - low)))
    kept = [rows[0]]
    for radius, length in rows[1:]:
        if abs(radius - kept[-1][0]) <= EXACT:
            kept[-1] = (kept[-1][0], kept[-1][1] + length)
        else:
            kept.append((radius, length))
    # The triangles lie within the circles, by less than the sides of their polygons make it.
    volume = sum(math.pi * radius**2 * length for radius, length in kept)
    if not 0.9 * volume < body.volume <= volume * (1.0 + 1e-4):
        return None
    least = 2.0 * EXACT
    return tuple(kept) if all(r > least and n > least for r, n in kept) else None


def _levels(heights: Array) -> list[float]:
    """Return the distinct heights, from below."""
    levels: list[float] = []
    for height in np.sort(heights).tolist():
        if not levels or height - levels[-1] > EXACT:
            levels.append(height)
    return levels


def _own_forms(body: CadBody) -> Iterator[Mapping[str, Any] | None]:
    for number in np.unique(body.surfaces).tolist():
        yield body.forms[number] if number >= 0 else None


def _rounded(length: float) -> float:
    """Return a length without the noise of seven digits [m]."""
    return round(length, 7)
