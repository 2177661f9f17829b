"""Shapes as coal knows them by itself: round things round, and hulls of what meshes are cut into."""

from __future__ import annotations

from functools import singledispatch
from typing import Any

import coal
import numpy as np

from planning.cell.shape import Box, Capsule, Cylinder, Form, Mesh, Shape
from planning.transforms import Array, Transform

_Posed = tuple[Any, Transform]


def coal_forms(shape: Shape) -> list[_Posed]:
    """Return coal's convex shapes of a shape, each with its pose in the frame of the shape."""
    return [
        (item, element.pose)
        for element in shape.elements
        for item in _forms(element.form)
    ]


@singledispatch
def _forms(form: Form) -> list[Any]:
    raise TypeError(f"no form: {form!r}")


@_forms.register
def _(form: Box) -> list[Any]:
    return [coal.Box(*form.size)]


@_forms.register
def _(form: Cylinder) -> list[Any]:
    return [coal.Cylinder(form.radius, form.length)]


@_forms.register
def _(form: Capsule) -> list[Any]:
    # Also without length: coal's own answer for a sphere deep in a cylinder is the way out
    # through the side, even where that through an end is shorter.
    return [coal.Capsule(form.radius, form.length)]


@_forms.register
def _(form: Mesh) -> list[Any]:
    return [_hull(points) for points in form.hulls]


def _hull(points: Array) -> Any:
    model = coal.BVHModelOBBRSS()
    model.beginModel(0, len(points))
    model.addVertices(np.asarray(points, dtype=np.float64))
    model.endModel()
    model.buildConvexHull(True, "Qt")
    return model.convex
