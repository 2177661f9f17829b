"""Layout of a study's pictures: legends and names that fit, whatever their length."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath

from twin.host.pictures import new_picture, style_axes

WIDTH_IN = 10.0
"""Width of a picture: letters are still read where a page shows it at three quarters [in]."""

_NAME = 38
"""Letters of a line of a name beside a bar."""

_LEGEND_SIZE = 9
"""Size of the legend [points]."""

_MARK = 4.5
"""What the mark of an entry and the gap to the next take, in letters' heights."""

_ROW_IN = 0.19
"""Height of a row of the legend [in]."""


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
    """Put the legend under the chart, whole: the picture grows by its rows.

    Names are laid out in as many columns as fit beside each other.
    """
    handles, labels = axes.get_legend_handles_labels()
    if not labels:
        return
    figure = axes.figure
    assert isinstance(figure, Figure)
    width, height = figure.get_size_inches().tolist()
    font = FontProperties(size=_LEGEND_SIZE)
    wrapped = [fill(label, 90) for label in labels]
    inches = [
        (_text_width(label, font) + _MARK * _LEGEND_SIZE) / 72.0 for label in wrapped
    ]
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


def _text_width(text: str, font: FontProperties) -> float:
    """Return the width of the longest line of a text [pt]."""
    return max(
        TextPath((0, 0), line, prop=font).get_extents().width if line.strip() else 0.0
        for line in text.split("\n")
    )
