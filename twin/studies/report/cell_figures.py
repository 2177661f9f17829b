"""Charts for one cell of a study: task times, and the sensitivity of the makespan.

A cell of a study is one policy with one variant of the inputs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from planning.tasks.task import TaskKind
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.activities.activities import part_names
from twin.drawing.pictures import (
    INK,
    WIDTH_IN,
    bar_chart,
    legend_below,
    new_picture,
    style_axes,
    wrap_name,
)
from twin.durations.nanoseconds import NANOSECONDS
from twin.studies.replications.block_results import TaskTally, task_groups
from twin.studies.replications.statistics import Interval
from twin.studies.sensitivity import SHARE, Influence, SobolIndex

_LESS, _MORE = "#1f5f9e", "#d97b29"
_TASKS_A_ROW = 30
_MOST_LANES = 160
"""Lanes of all rows together."""
_PANEL_IN, _NAME_SIZE = 0.84 * WIDTH_IN, 6.0
"""Width of a row of lanes [in], and size of the names of parts [points]."""
_CRITICALITY = colormaps["YlOrRd"]


def draw_bands(tpg: TemporalPlanGraph, tally: TaskTally) -> Figure:
    """Draw the median start and end of every task, with bands from P10 to P90.

    A task is coloured by its criticality index: how often it was on the critical path. The thin
    lines before and after it reach from the P10 to the P90 of its start and of its end.

    Args:
        tpg: the plan that was executed.
        tally: of its tasks; long plans wrap into several rows, of very long ones the first is drawn.
    """
    groups = task_groups(tpg)
    lane_of = {chain.robot: k for k, chain in enumerate(tpg.chains)}
    start = np.percentile(tally.start_ns, (10, 50, 90), axis=0) / NANOSECONDS
    end = np.percentile(tally.end_ns, (10, 50, 90), axis=0) / NANOSECONDS
    share, names = tally.critical / max(tally.count, 1), part_names(tpg)
    total = float(end[2].max())
    rows = max(1, -(-len(groups.task) // (_TASKS_A_ROW * len(lane_of))))
    if rows * len(lane_of) > _MOST_LANES:
        fewer = max(1, _MOST_LANES // len(lane_of))
        total, rows = total * fewer / rows, fewer
    height = 1.2 + rows * (0.5 + 0.46 * len(lane_of))
    figure = new_picture(WIDTH_IN, height, dpi=110)
    panels: list[Axes] = figure.subplots(rows, 1, squeeze=False)[:, 0].tolist()
    for row, axes in enumerate(panels):
        low, high = total * row / rows, total * (row + 1) / rows
        axes.set_xlim(low, high)
        axes.set_ylim(len(lane_of) - 0.4, -0.6)
        axes.set_yticks(range(len(lane_of)), list(lane_of))
        style_axes(axes, grid="x")
        seen = np.flatnonzero((end[2] >= low) & (start[0] <= high))
        tasks = [tpg.tasks[index] for index in groups.task[seen].tolist()]
        _draw_tasks(
            axes,
            np.array([lane_of[task.robot] for task in tasks]),
            start[:, seen],
            end[:, seen],
            share[seen],
            [
                "" if task.kind == TaskKind.TRANSIT else names[task.index]
                for task in tasks
            ],
        )
    panels[-1].set_xlabel(
        f"time [s]; bars from median start to median end, with the part that it is about,\n"
        f"lines from P10 to P90 of {len(tally.start_ns)} replications"
    )
    figure.colorbar(
        ScalarMappable(Normalize(0, 100), _CRITICALITY),
        ax=panels,
        label="criticality index [%]",
        fraction=0.02,
        pad=0.01,
    )
    return figure


def draw_tornado(influences: Sequence[Influence], mean_s: float) -> Figure:
    """Draw a tornado chart: mean makespan with inputs smaller and larger.

    Args:
        influences: the strongest first.
        mean_s: the mean makespan [s].
    """
    figure, axes = bar_chart([one.name for one in influences], 0.36)
    for k, one in enumerate(influences):
        for offset, colour, found in (
            (-0.1, _LESS, one.less_s),
            (0.1, _MORE, one.more_s),
        ):
            axes.barh(k, found.estimate, color=colour, height=0.62)
            _draw_interval(axes, k + offset, found)
    for colour, word in ((_LESS, "less"), (_MORE, "more")):
        axes.add_patch(
            Rectangle((0, 0), 0, 0, color=colour, label=f"{100 * SHARE:.0f} % {word}")
        )
    axes.axvline(0, color=INK, linewidth=1.0)
    axes.set_xlabel(f"change of the mean makespan of {mean_s:.1f} s [s]")
    legend_below(axes)
    return figure


def _draw_interval(axes: Axes, place: float, found: Interval) -> None:
    """Draw an interval as a line on its bar; nothing where it is open."""
    if np.isfinite(found.half_width):
        axes.plot([found.low, found.high], [place, place], color=INK, linewidth=0.9)


def draw_sobol(indices: Sequence[SobolIndex]) -> Figure:
    """Draw the shares of inputs in the variance of the mean makespan."""
    figure, axes = bar_chart([one.name for one in indices], 0.42)
    places = np.arange(len(indices))
    for offset, colour, label, values in (
        (-0.18, _LESS, "alone", [one.first for one in indices]),
        (0.18, _MORE, "alone and together with others", [o.total for o in indices]),
    ):
        estimates = [found.estimate for found in values]
        axes.barh(places + offset, estimates, height=0.34, color=colour, label=label)
        for place, found in zip(places + offset, values, strict=True):
            _draw_interval(axes, place, found)
    legend_below(axes)
    axes.set_xlabel(
        f"share in the variance of the mean makespan, inputs within"
        f" {100 * SHARE:.0f} % of what they are"
    )
    return figure


def _draw_tasks(
    axes: Axes,
    lanes: Indices,
    start: Array,
    end: Array,
    share: Array,
    texts: Sequence[str],
) -> None:
    """Draw tasks as bars, with names and bands."""
    named = np.array([bool(text) for text in texts], dtype=bool)
    half = np.where(named, 0.31, 0.17)
    left, right, low, high = start[1], end[1], lanes - half, lanes + half
    corners = np.stack([(left, low), (right, low), (right, high), (left, high)], axis=0)
    colours = _CRITICALITY(share)
    colours[share <= 0] = to_rgba("#eef0f2")
    axes.add_collection(
        PolyCollection(
            list(np.moveaxis(corners, 2, 0)),
            facecolors=colours,
            edgecolors="#8a929b",
            linewidths=0.4,
        )
    )
    bands = [
        [(times[0, k], lanes[k] + offset), (times[2, k], lanes[k] + offset)]
        for times, offset in ((start, -0.36), (end, 0.36))
        for k in np.flatnonzero(named)
    ]
    axes.add_collection(LineCollection(bands, colors=INK, linewidths=1.1, alpha=0.7))
    begin, until = axes.get_xlim()
    for k in np.flatnonzero(named).tolist():
        # A name stands where its bar is seen; a wider one would run into its neighbour's.
        seen = max(float(left[k]), begin), min(float(right[k]), until)
        width = (seen[1] - seen[0]) / (until - begin) * _PANEL_IN * 72.0 - 1.5
        label = wrap_name(texts[k], width, _NAME_SIZE, lines=3)
        if label:
            axes.text(
                0.5 * sum(seen),
                lanes[k],
                label,
                ha="center",
                va="center",
                fontsize=_NAME_SIZE,
                linespacing=1.0,
                color="white" if share[k] > 0.6 else INK,
                clip_on=True,
            )
