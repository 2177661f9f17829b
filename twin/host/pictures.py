"""Style of all pictures, and atomic writing of them."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from twin.host.guard import replacing

INK, GRID, FRAME = "#2b2f36", "#e4e7eb", "#b8bec6"
"""Colours of text and lines, of the grid, and of the lines around the axes."""


def new_picture(width: float, height: float, *, dpi: int = 120) -> Figure:
    """Return a picture of a size [in] whose parts make room for each other."""
    return Figure(
        figsize=(width, height), dpi=dpi, facecolor="white", layout="constrained"
    )


def style_axes(axes: Axes, *, grid: Literal["x", "y", "both"] = "both") -> None:
    """Give axes a quiet grid behind what is drawn, and no frame but where values are read."""
    axes.set_axisbelow(True)
    axes.grid(axis=grid, color=GRID, linewidth=0.8)
    axes.tick_params(colors=INK, labelsize=9)
    for side in ("top", "right") if grid == "both" else ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    for spine in axes.spines.values():
        spine.set_color(FRAME)


def save_png(picture: Figure, path: Path) -> None:
    """Write a picture, replacing what is there; OutputError when that cannot be done."""
    with replacing(path) as temporary:
        picture.savefig(temporary, format="png")
