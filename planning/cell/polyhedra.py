"""Polyhedra that contain round forms: as planning sees cylinders and capsules.

Every face touches the round form, so a polyhedron stands out of it at its edges only. It has as
many sides as it takes to stand out by no more than a tenth of a millimetre, between 16 and 48:
the round side of a bar of 5 mm radius is exceeded by 0.10 mm, of one of 15 mm by 0.09 mm, and of
any beyond 47 mm by 0.21 percent of the radius. The half spheres of a capsule are exceeded by up
to 4 percent of the radius.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise

import numpy as np

from planning.cell.body import ConvexBody
from planning.cell.cover import capsule_cover
from planning.cell.forms import Capsule, Cylinder
from planning.transforms import readonly

_STANDS_OUT = 1e-4
"""Sides are added until a polyhedron stands out of its form by no more than this [m]."""

_FEWEST, _MOST, _STEP = 16, 48, 4
"""Numbers of sides: from, to, and in steps of."""

_LATITUDES = np.linspace(0.0, 0.5 * math.pi, 5)


def sides(radius: float) -> int:
    """Return the number of sides of the polyhedron around a round bar: a multiple of four."""
    for count in range(_FEWEST, _MOST, _STEP):
        if radius * (1.0 / math.cos(math.pi / count) - 1.0) <= _STANDS_OUT:
            return count
    return _MOST


@lru_cache(maxsize=256)
def round_body(form: Cylinder | Capsule) -> ConvexBody:
    """Return the polyhedron around a cylinder or a capsule, in the frame of the form."""
    rings = _of_cylinder(form) if isinstance(form, Cylinder) else _of_capsule(form)
    count = sides(form.radius)
    # Corners are half-way between the points where the faces touch the round side.
    turn = 2.0 * math.pi * (np.arange(count) + 0.5) / count
    vertices = np.vstack(
        [
            np.column_stack(
                [out * np.cos(turn), out * np.sin(turn), np.full(count, high)]
            )
            for out, high in rings
        ]
    )
    return ConvexBody("round", readonly(vertices), capsule_cover(vertices))


def _of_cylinder(form: Cylinder) -> list[tuple[float, float]]:
    """Return the rings of corners: how far from the axis, and how high."""
    out = form.radius / math.cos(math.pi / sides(form.radius))
    return [(out, -0.5 * form.length), (out, 0.5 * form.length)]


def _of_capsule(form: Capsule) -> list[tuple[float, float]]:
    """Return the rings of corners, each where the faces of two latitudes meet."""
    edge = math.cos(math.pi / sides(form.radius))
    rings = []
    for low, high in pairwise(_LATITUDES.tolist()):
        faces = [[math.cos(a) * edge, math.sin(a)] for a in (low, high)]
        out, up = np.linalg.solve(faces, [form.radius, form.radius]).tolist()
        rings += [(out, 0.5 * form.length + up), (out, -0.5 * form.length - up)]
    return rings
