"""The Gantt chart of a study: when tasks are done, how far that spreads, how critical they are."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from planning.tasks.task import TRANSIT
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations import NANOSECONDS
from twin.host.pictures import INK, new_picture, style_axes
from twin.study.replications.task_tally import TaskTally, task_groups

_TASKS_A_ROW = 44
_CRITICALITY = colormaps["YlOrRd"]


def draw_bands(tpg: TemporalPlanGraph, tally: TaskTally) -> Figure:
    """Draw the median start and end of every task, with bands from P10 to P90.

    A task is coloured by its criticality index: how often it was on the critical path. The thin
    lines before and after it reach from the P10 to the P90 of its start and of its end.

    Args:
        tpg: the plan that was executed.
        tally: of its tasks; long plans wrap into several rows.
    """
    groups = task_groups(tpg)
    lane_of = {chain.robot: k for k, chain in enumerate(tpg.chains)}
    start = np.percentile(tally.start_ns, (10, 50, 90), axis=0) / NANOSECONDS
    end = np.percentile(tally.end_ns, (10, 50, 90), axis=0) / NANOSECONDS
    share = tally.critical / max(tally.count, 1)
    total = float(end[2].max())
    rows = max(1, -(-len(groups.task) // (_TASKS_A_ROW * len(lane_of))))
    height = 1.2 + rows * (0.5 + 0.46 * len(lane_of))
    figure = new_picture(14.0, height, dpi=110)
    panels: list[Axes] = figure.subplots(rows, 1, squeeze=False)[:, 0].tolist()
    for row, axes in enumerate(panels):
        low, high = total * row / rows, total * (row + 1) / rows
        axes.set_xlim(low, high)
        axes.set_ylim(len(lane_of) - 0.4, -0.6)
        axes.set_yticks(range(len(lane_of)), list(lane_of))
        style_axes(axes, grid="x")
        for k, index in enumerate(groups.task.tolist()):
            if end[2, k] < low or start[0, k] > high:
                continue
            task = tpg.tasks[index]
            _draw_task(
                axes,
                lane_of[task.robot],
                start[:, k],
                end[:, k],
                float(share[k]),
                "" if task.kind == TRANSIT else str(task.step),
                width=high - low,
            )
    panels[-1].set_xlabel(
        f"time [s]; bars from median start to median end, lines from P10 to P90 of"
        f" {len(tally.start_ns)} replications"
    )
    figure.colorbar(
        ScalarMappable(Normalize(0, 100), _CRITICALITY),
        ax=panels,
        label="criticality index [%]",
        fraction=0.02,
        pad=0.01,
    )
    return figure


def _draw_task(
    axes: Axes,
    lane: int,
    start: Array,
    end: Array,
    share: float,
    text: str,
    *,
    width: float,
) -> None:
    thin = not text
    height = 0.34 if thin else 0.62
    axes.barh(
        lane,
        end[1] - start[1],
        left=start[1],
        height=height,
        color=_CRITICALITY(share) if share > 0 else "#eef0f2",
        edgecolor="#8a929b",
        linewidth=0.4,
    )
    for times, offset in ((start, -0.36), (end, 0.36)):
        if not thin:
            axes.plot(
                times[[0, 2]], [lane + offset] * 2, color=INK, linewidth=1.1, alpha=0.7
            )
    if text and end[1] - start[1] > 0.007 * width:
        axes.text(
            0.5 * (start[1] + end[1]),
            lane,
            text,
            ha="center",
            va="center",
            fontsize=7,
            color="white" if share > 0.6 else INK,
            clip_on=True,
        )
