"""Selection of small areas of a view that are drawn again at a larger scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from planning.transforms import Array

_TINY = 18.0
"""Objects that appear smaller than this are drawn again at a larger scale [points]."""

_NEAR = 0.06
"""Objects closer to each other than this share of the view are drawn together."""

_ROOM, _LARGER = 0.1, 1.5
"""Room around what is drawn again, of its size, and how much larger it must become for it to be."""

MOST = 4
"""Close-ups of a picture."""


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
