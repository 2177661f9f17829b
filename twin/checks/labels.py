"""Placement of name labels in a view without overlap."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from matplotlib.axes import Axes

from planning.transforms import Array
from twin.drawing.pictures import FRAME

NAME_SIZE = 6
"""Font size of names in the picture [points]."""

_LETTER, _LINE = 0.3, 0.75
"""Half the width and half the height of a name, over its size and letters."""


@dataclass
class Names:
    """Writes name labels at free positions.

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
