"""Orthographic projections of bodies, drawn with matplotlib."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull, QhullError

from planning.cell.cover import box_body
from planning.transforms import Array, Transform
from twin.drawing.pictures import INK, style_axes

_AXIS_COLOURS = ("#d62728", "#2ca02c", "#1f4fd6")
"""Of the x, y and z axes of frames."""


@dataclass(frozen=True)
class Viewpoint:
    """A projection: the world axes to the right, up, and towards the viewer."""

    title: str
    right: int
    up: int
    eye: int
    towards: float

    @classmethod
    def from_side(cls) -> Viewpoint:
        """Return the projection along y."""
        return cls("from the side (-y)", 0, 2, 1, -1.0)

    @property
    def flat(self) -> list[int]:
        """The world axes of the view plane."""
        return [self.right, self.up]


@dataclass(frozen=True)
class DrawnShape:
    """A convex hull to draw: corners in the world, and how."""

    corners: Array
    face: object
    edge: object
    alpha: float | None
    width: float = 0.5
    line: Any = "solid"


def style_view(area: Axes, view: Viewpoint, title: str | None = None) -> None:
    """Style matplotlib axes for a view, with its title or another one."""
    style_axes(area)
    area.set_title(title or view.title, color=INK, fontsize=10, loc="left")
    area.set_aspect("equal")
    area.set_xlabel("xyz"[view.right] + " [m]", color=INK)
    area.set_ylabel("xyz"[view.up] + " [m]", color=INK)


def draw_shapes(area: Axes, view: Viewpoint, shapes: Iterable[DrawnShape]) -> None:
    """Draw shapes, those that are nearer to the eye over the others."""
    for shape in sorted(
        shapes, key=lambda s: float((view.towards * s.corners[:, view.eye]).max())
    ):
        area.add_patch(
            Polygon(
                outline_of_hull(shape.corners[:, view.flat]),
                closed=True,
                facecolor=shape.face,
                edgecolor=shape.edge,
                alpha=shape.alpha,
                linewidth=shape.width,
                linestyle=shape.line,
            )
        )


def draw_axes(area: Axes, view: Viewpoint, pose: Transform, length: float) -> None:
    """Draw the axes of a frame: x red, y green, z blue."""
    for axis, colour in enumerate(_AXIS_COLOURS):
        line = np.array([pose[:3, 3], pose[:3, 3] + length * pose[:3, axis]])
        across, along = line[:, view.flat].T
        area.plot(across, along, color=colour, linewidth=1.8, zorder=5)


def box_corners(size: Array, pose: Transform) -> Array:
    """Return the corners of a box in its place, shape (8, 3) [m]."""
    return placed_points(box_body("place", size).vertices, pose)


def placed_points(points: Array, pose: Transform) -> Array:
    """Return points of a frame in the world, shape (n, 3) [m]."""
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def outline_of_hull(points: Array) -> Array:
    """Return the corners of the hull of points in a plane, in order, shape (c, 2)."""
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:  # seen edge-on
        return points


def widen_rectangle(low: Array, high: Array, ratio: float) -> Sequence[Array]:
    """Return the corners of a rectangle that has another in its middle, and a ratio of width to height."""
    size = high - low
    wanted = np.array([max(size[0], ratio * size[1]), max(size[1], size[0] / ratio)])
    return low - 0.5 * (wanted - size), high + 0.5 * (wanted - size)
