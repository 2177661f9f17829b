"""Views of bodies in space along an axis of the world, as matplotlib draws them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull, QhullError

from planning.transforms import Array, Transform
from twin.host.pictures import INK, style_axes

_AXIS_COLOURS = ("#d62728", "#2ca02c", "#1f4fd6")
"""Of the x, y and z axes of frames."""


@dataclass(frozen=True)
class Viewpoint:
    """A projection: the axes of the world that go right and up, and the one towards the eye."""

    title: str
    right: int
    up: int
    eye: int
    towards: float

    @property
    def flat(self) -> list[int]:
        """The axes of the world that are seen."""
        return [self.right, self.up]


FROM_THE_SIDE = Viewpoint("from the side (-y)", 0, 2, 1, -1.0)


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
    """Make axes those of a view, with its title or another one."""
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
                hull_outline(shape.corners[:, view.flat]),
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


def placed_points(points: Array, pose: Transform) -> Array:
    """Return points of a frame in the world, shape (n, 3) [m]."""
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def hull_outline(points: Array) -> Array:
    """Return the corners of the hull of points in a plane, in order, shape (c, 2)."""
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:  # seen edge-on
        return points
