"""Orthographic views of bodies in matplotlib, and close-ups of small things."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull, QhullError

from planning.cell.cover import box_body
from planning.transforms import Array, Transform
from twin.drawing.pictures import FRAME, INK, style_axes

_AXIS_COLOURS = ("#d62728", "#2ca02c", "#1f4fd6")
"""Of the x, y and z axes of frames."""

NAME_SIZE = 6
"""Size of names in the picture [points]."""

_LETTER, _LINE = 0.3, 0.75
"""Half the width and half the height of a name, over its size and letters."""

_TINY = 18.0
"""Things that are drawn smaller are drawn again [points]."""

_NEAR = 0.06
"""Things nearer to each other than this share of the view are drawn together."""

_ROOM, _LARGER = 0.1, 1.5
"""Room around what is drawn again, of its size, and how much larger it must become for it to be."""

MOST = 4
"""Close-ups of a picture."""


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


@dataclass(frozen=True)
class CloseUp:
    """A rectangle of a view.

    Attributes:
        letter: names it in the picture.
        low, high: its corners, shape (2,) [m].
    """

    letter: str
    low: Array
    high: Array

    def holds(self, box: Array) -> bool:
        """Return whether a thing is in it, by its corners, shape (2, 2)."""
        return bool(np.all(self.low <= box[0]) and np.all(box[1] <= self.high))


def find_close_ups(
    boxes: Array, extent: Array, metres_per_point: float, row: tuple[float, float]
) -> list[CloseUp]:
    """Return the close-ups of a view.

    Things that are near each other are drawn together; a single one has room for its name next to it.

    Args:
        boxes: lower and upper corners of the things in the view, shape (n, 2, 2) [m].
        extent: edges of the view, shape (2,) [m].
        metres_per_point: scale of the view.
        row: width and height of the row that they are drawn in [in].
    """
    sizes = np.max(boxes[:, 1] - boxes[:, 0], axis=1) if len(boxes) else np.empty(0)
    if not np.any(sizes < _TINY * metres_per_point):
        return []
    tiny = sizes < _TINY * metres_per_point
    reach = _NEAR * float(extent.max())
    groups = _groups(boxes, tiny, reach)
    while len(groups) > MOST:
        reach *= 1.3
        groups = _groups(boxes, tiny, reach)
    found = []
    panel = np.array([panel_width(row[0], max(len(groups), 1)), row[1]])
    for group in groups:
        low, high = boxes[group, 0].min(axis=0), boxes[group, 1].max(axis=0)
        margin = _ROOM * float((high - low).max()) + 12.0 * metres_per_point / _LARGER
        low, high = low - margin, high + margin
        if _LARGER * float(np.max((high - low) / panel)) / 72.0 < metres_per_point:
            found.append((low, high))
    found.sort(key=lambda corners: (float(corners[0][0]), float(corners[0][1])))
    return [CloseUp(chr(65 + k), *corners) for k, corners in enumerate(found)]


def panel_width(width: float, count: int) -> float:
    """Return the width of each of some panels in a row, without axis labels [in]."""
    return width / count - 0.8


def _groups(boxes: Array, tiny: npt.NDArray[np.bool_], reach: float) -> list[list[int]]:
    """Return groups of boxes, each near another one of its group.

    Only groups of several with something tiny among them.
    """
    apart = np.maximum(
        boxes[:, None, 0] - boxes[None, :, 1], boxes[None, :, 0] - boxes[:, None, 1]
    ).max(axis=2)
    left, groups = set(range(len(boxes))), []
    while left:
        group, todo = [], [left.pop()]
        while todo:
            k = todo.pop()
            group.append(k)
            near = {j for j in left if apart[k, j] <= reach}
            left -= near
            todo += near
        if len(group) > 1 and np.any(tiny[group]):
            groups.append(sorted(group))
    return groups


@dataclass
class Names:
    """Writes names where there is room.

    Attributes:
        area: to write in.
        scale: of it, metres a point.
        low, high: its corners, shape (2,) [m].
        adjacent: whether names may be next to things, where these do not hide each other.
    """

    area: Axes
    scale: float
    low: Array
    high: Array
    adjacent: bool = True
    _taken: list[tuple[float, float, float, float]] = field(default_factory=list)

    def mark(self, at: Array, text: str, colour: str, size: int = 9) -> None:
        """Write a robot's name, or the letter of a close-up, even over other things."""
        self._take(at, text, size)
        self._write(at, text, colour, size, bold=True)

    def name(self, box: Array, text: str, colour: str) -> None:
        """Write the name of a thing on it, else next to it; omit it where there is no room.

        Args:
            box: lower and upper corner of the thing, shape (2, 2) [m].
            text: its name.
            colour: of the name.
        """
        low, high = np.maximum(box[0], self.low), np.minimum(box[1], self.high)
        if np.any(high <= low):
            return
        for at in self._places(low, high, text):
            if self._free(at, text):
                self._take(at, text, NAME_SIZE)
                self._write(at, text, colour, NAME_SIZE)
                return

    def _places(self, low: Array, high: Array, text: str) -> Iterator[Array]:
        middle, (wide, tall) = 0.5 * (low + high), self._half(text, NAME_SIZE)
        inside = np.array([1.2 * wide, tall])
        if np.all(high - low > 8.0 * inside):
            yield low + inside
            yield high - inside
        if 0.5 * wide <= float((high - low).max()):  # else it would hide what it names
            yield middle
        if self.adjacent:
            yield np.array([middle[0], high[1] + tall])
            yield np.array([middle[0], low[1] - tall])
            yield np.array([high[0] + 1.2 * wide, middle[1]])
            yield np.array([low[0] - 1.2 * wide, middle[1]])

    def _half(self, text: str, size: int) -> tuple[float, float]:
        wide = _LETTER * size * len(text) * self.scale
        return wide, _LINE * size * self.scale

    def _free(self, at: Array, text: str) -> bool:
        wide, tall = self._half(text, NAME_SIZE)
        half = np.array([wide, tall])
        if np.any(at - half < self.low) or np.any(at + half > self.high):
            return False
        return not any(
            abs(at[0] - x) < wide + w and abs(at[1] - y) < tall + t
            for x, y, w, t in self._taken
        )

    def _take(self, at: Array, text: str, size: int) -> None:
        self._taken.append((float(at[0]), float(at[1]), *self._half(text, size)))

    def _write(
        self, at: Array, text: str, colour: str, size: int, *, bold: bool = False
    ) -> None:
        self.area.text(
            float(at[0]),
            float(at[1]),
            text,
            color=colour,
            fontsize=size,
            fontweight="bold" if bold else "normal",
            ha="center",
            va="center",
            zorder=7 if bold else 6,
            clip_on=True,
            bbox={"facecolor": "white", "edgecolor": FRAME, "alpha": 0.75, "pad": 1.0}
            if bold
            else {"facecolor": "white", "edgecolor": "none", "alpha": 0.55, "pad": 0.5},
        )


def widen_rectangle(low: Array, high: Array, ratio: float) -> Sequence[Array]:
    """Return the corners of a rectangle that has another in its middle, and a ratio of width to height."""
    size = high - low
    wanted = np.array([max(size[0], ratio * size[1]), max(size[1], size[0] / ratio)])
    return low - 0.5 * (wanted - size), high + 0.5 * (wanted - size)
