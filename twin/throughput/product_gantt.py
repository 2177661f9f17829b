"""Gantt chart by product: a bar from begin to completion, coloured by variant, with due times."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import cycle
from math import ceil

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.drawing.pictures import INK, new_picture, style_axes
from twin.runs.execution_record import ExecutionRecord
from twin.scenario.sections.kind import StartUp
from twin.throughput.throughput import due_of_places, run_product_times, seconds

_COLOURS = ("#1f5f9e", "#d97b29", "#2f7f66", "#9c4a8f", "#8c6d31", "#7a8592")
_LATE = "#c0392b"
_PRODUCTS_A_ROW, _MOST_LANES = 25, 150
"""Products of a row of lanes, whose numbers can be read, and lanes of all rows; further rows are omitted."""

_WIDTH_IN, _LANE_IN, _BAR = 11.0, 0.3, 0.6


def run_products_figure(
    tpg: TemporalPlanGraph,
    run: ExecutionRecord,
    due_s: Sequence[float] = (),
    start_up: StartUp = None,
    variants: Sequence[str] = (),
    scrapped: Collection[int] = (),
    *,
    title: str = "",
) -> Figure | None:
    """Return the chart of a run, see ``line_summary``; None for one product or an unfinished run."""
    times = run_product_times(tpg, run, len(due_s) or len(variants), scrapped)
    if times is None:
        return None
    begin, end = seconds(times.product_begin_ns), seconds(times.product_end_ns)
    return products_figure(begin[:, 0], end[:, 0], due_s, variants, title)


def products_figure(
    begin_s: Array,
    end_s: Array,
    due_s: Sequence[float] = (),
    variants: Sequence[str] = (),
    title: str = "",
) -> Figure:
    """Return a Gantt chart of products, in as many lanes as there are products in progress.

    Bars carry the number of the product, and so do triangles where it is due; a line over the bar says for
    how long it is late. Long runs wrap into several rows.

    Args:
        begin_s, end_s: begin and completion of each product, NaN for one that is not complete, shape (n,) [s].
        due_s: when each is due [s]; empty where none is.
        variants: the variant of each; empty where all are the same.
        title: first words of the heading.
    """
    lane, due = _lanes(begin_s, end_s), due_of_places(due_s, len(end_s))
    lanes, total = int(lane.max(initial=0)) + 1, float(np.nanmax(end_s)) * 1.01
    rows = ceil(len(end_s) / _PRODUCTS_A_ROW)
    shown = max(1, min(rows, _MOST_LANES // lanes))
    colours = dict(zip(dict.fromkeys(variants), cycle(_COLOURS), strict=False))
    figure = new_picture(_WIDTH_IN, 1.3 + shown * (lanes * _LANE_IN + 0.45), dpi=110)
    panels: list[Axes] = figure.subplots(shown, 1, squeeze=False)[:, 0].tolist()
    for row, axes in enumerate(panels):
        low, high = total * row / rows, total * (row + 1) / rows
        axes.set_xlim(low, high)
        axes.set_ylim(lanes - 0.45, -0.75)
        axes.set_yticks([])
        style_axes(axes, grid="x")
        seen = (np.fmax(end_s, due) >= low) & (begin_s < high)
        for k in np.flatnonzero(seen).tolist():
            own = variants[min(k, len(variants) - 1)] if variants else ""
            times = float(begin_s[k]), float(end_s[k]), float(due[k])
            _draw_product(axes, k, times, lane[k], colours.get(own, _COLOURS[0]))
    panels[-1].set_xlabel("time [s]", color=INK)
    words = f"{title}   {np.isfinite(end_s).sum()} products"
    words += f", {np.count_nonzero(end_s > due)} late" if len(due_s) else ""
    words += f" (the first {total * shown / rows:.0f} s)" if shown < rows else ""
    figure.suptitle(words.strip(), x=0.01, ha="left", color=INK, weight="bold")
    handles: list[Patch | Line2D] = [
        Patch(color=c, label=v) for v, c in colours.items()
    ]
    if len(due_s):
        mark = Line2D([], [], color=INK, ls="", marker="v", label="due")
        handles += [mark, Line2D([], [], color=_LATE, lw=2.2, label="late")]
    if handles:
        figure.legend(
            handles=handles, loc="outside lower center", ncols=6, frameon=False
        )
    return figure


def _lanes(begin_s: Array, end_s: Array) -> Indices:
    """Return for each product the first lane that is free when it begins."""
    free: list[float] = []
    found = np.zeros(len(begin_s), dtype=np.int64)
    for k in np.argsort(begin_s, kind="stable").tolist():
        if np.isfinite(end_s[k]):
            open_lanes = (n for n, t in enumerate(free) if t <= begin_s[k])
            found[k] = next(open_lanes, len(free))
            free[found[k] : found[k] + 1] = [end_s[k]]
    return found


def _draw_product(
    axes: Axes, product: int, times: tuple[float, float, float], lane: int, colour: str
) -> None:
    """Draw the bar of a product, counted from 0, of which begin, completion and due time are given [s]."""
    begin, end, due = times
    low, high = axes.get_xlim()
    axes.barh(lane, end - begin, _BAR, begin, color=colour, edgecolor="white", lw=0.6)
    left, right, label = max(begin, low), min(end, high), str(product + 1)
    if (right - left) / (high - low) * _WIDTH_IN * 72 > 6.0 * len(label):
        at = 0.5 * (left + right), lane
        axes.annotate(label, at, ha="center", va="center", size=7.5, color="white")
    top = lane - 0.5 * _BAR - 0.14
    if end > due:
        axes.plot([due, end], [top, top], color=_LATE, lw=2.2, solid_capstyle="butt")
    if low <= due < high:
        axes.plot([due], [top], marker="v", ms=4, color=_LATE if end > due else INK)
        if end <= due:  # others may have the lane by then
            axes.annotate(f"  {label}", (due, top), va="center", size=7.5, color=INK)
