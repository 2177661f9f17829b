"""Common style of all pictures and charts, with legends and names that are wrapped to fit."""

from __future__ import annotations

import re
from collections.abc import Sequence
from textwrap import fill
from typing import Literal

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath

_LETTER = 0.6
"""Width of a letter over its size."""

_WORDS = re.compile(
    r"[^\W\d_]{2,}[\s_.\-]*|[^\s_.\-]+?(?=[^\W\d_]{2,}|[\s_.\-]|$)[\s_.\-]*|[\s_.\-]+"
)
"""Words of a name with what parts them from the next one."""

INK, GRID, FRAME = "#2b2f36", "#e4e7eb", "#b8bec6"
"""Colours of text and lines, of the grid, and of the lines around the axes."""

WIDTH_IN = 9.0
"""Width of a picture: the smallest letters are still read at the width of a page [in]."""

_NAME = 38
"""Letters of a line of a name beside a bar."""

_LEGEND_SIZE = 9
"""Size of the legend [points]."""

_MARK = 4.5
"""What the mark of an entry and the gap to the next take, in letters' heights."""

_ROW_IN = 0.19
"""Height of a row of the legend [in]."""


def new_picture(width: float, height: float, *, dpi: int = 120) -> Figure:
    """Return a figure of a size [in] with constrained layout."""
    return Figure(
        figsize=(width, height), dpi=dpi, facecolor="white", layout="constrained"
    )


def style_axes(axes: Axes, *, grid: Literal["x", "y", "both"] = "both") -> None:
    """Style axes: a light grid behind the data, a frame only along value axes."""
    axes.set_axisbelow(True)
    axes.grid(axis=grid, color=GRID, linewidth=0.8)
    axes.tick_params(colors=INK, labelsize=9)
    for side in ("top", "right") if grid == "both" else ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    for spine in axes.spines.values():
        spine.set_color(FRAME)


def wrap_name(text: str, width: float, size: float, *, lines: int) -> str:
    """Wrap a name to a width in as few lines as possible; empty where it does not fit.

    Lines break behind separators, between a word and a number, and within words longer than a line.

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


def one_chart(height: float) -> tuple[Figure, Axes]:
    """Return a picture of one chart of a height [in]."""
    figure = new_picture(WIDTH_IN, height)
    axes = figure.subplots()
    style_axes(axes)
    return figure, axes


def bar_chart(names: Sequence[str], row: float) -> tuple[Figure, Axes]:
    """Return a picture for horizontal bars with their names, the first on top.

    Args:
        names: of the bars, wrapped where they are long.
        row: height of a bar [in].
    """
    wrapped = [fill(name, _NAME) for name in names]
    lines = max([1, *(name.count("\n") + 1 for name in wrapped)])
    figure, axes = one_chart(1.3 + max(row, 0.17 * lines + 0.08) * max(len(names), 1))
    axes.set_yticks(range(len(names)), wrapped)
    axes.set_ylim(len(names) - 0.4, -0.6)
    return figure, axes


def legend_below(axes: Axes) -> None:
    """Put the legend under the chart and enlarge the figure by its rows.

    Names are laid out in as many columns as fit the width.
    """
    handles, labels = axes.get_legend_handles_labels()
    if not labels:
        return
    figure = axes.figure
    assert isinstance(figure, Figure)
    width, height = figure.get_size_inches().tolist()
    font = FontProperties(size=_LEGEND_SIZE)
    wrapped = [fill(label, 90) for label in labels]
    widths = [
        max(
            TextPath((0, 0), s, prop=font).get_extents().width
            for s in label.split("\n")
        )
        for label in wrapped
    ]
    inches = [(width + _MARK * _LEGEND_SIZE) / 72.0 for width in widths]
    columns = int(max(1, min(len(labels), 0.97 * width // max(inches))))
    rows = -(-len(labels) // columns)
    lines = max(label.count("\n") + 1 for label in wrapped)
    figure.set_size_inches(width, height + _ROW_IN * lines * (rows - 1))
    figure.legend(
        handles,
        wrapped,
        loc="outside lower center",
        ncols=columns,
        frameon=False,
        fontsize=_LEGEND_SIZE,
    )
