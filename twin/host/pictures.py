"""Style of all pictures, and atomic writing of them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from twin.host.guard import replacing

_LETTER = 0.6
"""Width of a letter over its size."""

_WORDS = re.compile(
    r"[^\W\d_]{2,}[\s_.\-]*|[^\s_.\-]+?(?=[^\W\d_]{2,}|[\s_.\-]|$)[\s_.\-]*|[\s_.\-]+"
)
"""Words of a name with what parts them from the next one."""

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


def fitted(text: str, width: float, size: float, *, lines: int) -> str:
    """Return a name in as few lines as it takes to fit a width; empty where it does not fit.

    Lines end behind what parts words in names, between a word and a number, and within words that are too
    long for a line.

    Args:
        text: the name.
        width: of the room [points].
        size: of the letters [points].
        lines: that there is room for.
    """
    most = int(width / (_LETTER * size))
    if most < 1:
        return ""
    out = [""]
    for word in _WORDS.findall(text):
        if len(out[-1]) + len(word.rstrip()) > most and out[-1]:
            out.append("")
        out[-1] += word
        while len(out[-1].rstrip()) > most:
            out[-1:] = [out[-1][:most], out[-1][most:]]
    return "\n".join(line.rstrip() for line in out) if len(out) <= lines else ""


def save_png(picture: Figure, path: Path) -> None:
    """Write a picture, replacing what is there; OutputError when that cannot be done."""
    with replacing(path) as temporary:
        picture.savefig(temporary, format="png")
