"""The pictures of a study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from planning.tasks.task import TRANSIT
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    TASK_DEPENDENCY,
    TemporalPlanGraph,
)
from twin.durations import NANOSECONDS
from twin.engine.bulk.policy_graph import OTHER
from twin.host.pictures import INK, new_picture, style_axes
from twin.study.replications.block_results import WAIT_COLUMNS, TaskTally, task_groups
from twin.study.sensitivity import SHARE, Influence, SobolIndex
from twin.study.summary import cell_label

COLOURS = ("#1f5f9e", "#d97b29", "#2f7f66", "#9c4a8f", "#7a8592", "#b8433a")
CAUSE_STYLE = {
    TASK_DEPENDENCY: ("#6fa8dc", "for another robot's task"),
    MOTION_CONFLICT: ("#d97b29", "for the way to be free"),
    OTHER: ("#b9c0c8", "for a message, the clock or a turn"),
}
_DASHES = ("-", "--", ":", "-.")
_TASKS_A_ROW = 44
_CRITICALITY = colormaps["YlOrRd"]


def draw_ecdf(
    summary: Mapping[str, Any], samples: Sequence[Array], policies: Sequence[str]
) -> Figure:
    """Draw the share of replications that are over by a time, for every cell.

    Args:
        summary: the content of ``summary.json``.
        samples: makespans of each cell, NaN where it did not complete [s].
        policies: in the order of their colours.
    """
    figure, axes = _figure(9.0, 4.6)
    for k, (cell, sample) in enumerate(zip(summary["cells"], samples, strict=True)):
        ordered = np.sort(sample[np.isfinite(sample)])
        if len(ordered) == 0:
            continue
        policy = policies.index(cell["policy"])
        variant = k // len(policies)
        axes.step(
            np.concatenate([ordered[:1], ordered]),
            np.arange(len(ordered) + 1) / len(sample) * 100,
            where="post",
            color=COLOURS[policy % len(COLOURS)],
            linestyle=_DASHES[variant % len(_DASHES)],
            linewidth=1.8,
            label=cell_label(cell),
        )
    if summary["deadline_s"] is not None:
        axes.axvline(summary["deadline_s"], color=INK, linewidth=1.0)
        axes.annotate(
            f" deadline {summary['deadline_s']:g} s",
            (summary["deadline_s"], 2),
            color=INK,
            fontsize=9,
        )
    axes.set_xlabel("makespan [s]")
    axes.set_ylabel("replications that are over [%]")
    axes.set_ylim(0, 100.5)
    _legend_below(axes)
    return figure


def draw_waits(summary: Mapping[str, Any]) -> Figure:
    """Draw what the robots waited for, by cause, a bar a cell."""
    cells = [cell for cell in summary["cells"] if "wait_s" in cell]
    figure, axes = _figure(9.0, 1.5 + 0.42 * max(len(cells), 1))
    left = np.zeros(len(cells))
    for cause, (colour, label) in CAUSE_STYLE.items():
        values = np.array([cell["wait_s"][WAIT_COLUMNS[cause]] for cell in cells])
        axes.barh(range(len(cells)), values, left=left, color=colour, label=label)
        left = left + values
    for k, total in enumerate(left.tolist()):
        axes.annotate(f" {total:.0f} s", (total, k), va="center", fontsize=9, color=INK)
    axes.margins(x=0.1)
    _label_bars(axes, [cell_label(cell) for cell in cells])
    axes.set_xlabel("mean wait of all robots together [s]")
    return figure


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


def draw_tornado(influences: Sequence[Influence], mean_s: float) -> Figure:
    """Draw what the mean makespan does when inputs are smaller and larger.

    Args:
        influences: the strongest first.
        mean_s: the mean makespan [s].
    """
    shown = list(influences)[:14]
    figure, axes = _figure(9.0, 1.5 + 0.36 * max(len(shown), 1))
    for k, one in enumerate(shown):
        axes.barh(k, one.less_s, color=COLOURS[0], height=0.62)
        axes.barh(k, one.more_s, color=COLOURS[1], height=0.62)
    for colour, word in ((COLOURS[0], "less"), (COLOURS[1], "more")):
        axes.add_patch(
            Rectangle((0, 0), 0, 0, color=colour, label=f"{100 * SHARE:.0f} % {word}")
        )
    axes.axvline(0, color=INK, linewidth=1.0)
    _label_bars(axes, [one.name for one in shown])
    axes.set_xlabel(f"change of the mean makespan of {mean_s:.0f} s [s]")
    return figure


def draw_sobol(indices: Sequence[SobolIndex]) -> Figure:
    """Draw the shares of inputs in the variance of the mean makespan."""
    shown = list(indices)[:14]
    figure, axes = _figure(9.0, 1.5 + 0.42 * max(len(shown), 1))
    places = np.arange(len(shown))
    for offset, colour, label, values in (
        (-0.18, COLOURS[0], "alone", [one.first for one in shown]),
        (0.18, COLOURS[1], "alone and together with others", [o.total for o in shown]),
    ):
        axes.barh(places + offset, values, height=0.34, color=colour, label=label)
    _label_bars(axes, [one.name for one in shown])
    axes.set_xlabel(
        f"share in the variance of the mean makespan, inputs within"
        f" {100 * SHARE:.0f} % of what they are"
    )
    return figure


def draw_response(
    summary: Mapping[str, Any], key: str, policies: Sequence[str]
) -> Figure:
    """Draw the mean makespan, with its interval, over an input that is varied.

    Where other inputs are varied too, each of their combinations is a line.
    """
    figure, axes = _figure(9.0, 4.2)
    lines: dict[tuple[str, str], list[tuple[Any, Mapping[str, Any]]]] = {}
    for cell in summary["cells"]:
        if "makespan_s" not in cell:
            continue
        others = {k: v for k, v in cell["variant"].items() if k != key}
        label = cell_label({"policy": cell["policy"], "variant": others})
        entry = (cell["variant"][key], cell["makespan_s"])
        lines.setdefault((cell["policy"], label), []).append(entry)
    values = list(dict.fromkeys(cell["variant"][key] for cell in summary["cells"]))
    numeric = all(isinstance(value, int | float) for value in values)
    seen: dict[str, int] = {}
    for (policy, label), entries in lines.items():
        place = [value if numeric else values.index(value) for value, _ in entries]
        mean = np.array([entry["estimate"] for _, entry in entries])
        low = np.array([_known(entry["low"], entry) for _, entry in entries])
        high = np.array([_known(entry["high"], entry) for _, entry in entries])
        dash = _DASHES[seen.get(policy, 0) % len(_DASHES)]
        seen[policy] = seen.get(policy, 0) + 1
        axes.errorbar(
            place,
            mean,
            yerr=[mean - low, high - mean],
            color=COLOURS[list(policies).index(policy) % len(COLOURS)],
            linestyle=dash,
            marker="o",
            markersize=4,
            capsize=3,
            label=label,
        )
    if not numeric:
        axes.set_xticks(range(len(values)), [str(value) for value in values])
    axes.set_xlabel(key)
    axes.set_ylabel("mean makespan [s]")
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False, fontsize=9)
    return figure


def _known(bound: float | None, entry: Mapping[str, Any]) -> float:
    return float(entry["estimate"] if bound is None else bound)


def _figure(width: float, height: float) -> tuple[Figure, Axes]:
    figure = new_picture(width, height)
    axes = figure.subplots()
    style_axes(axes)
    return figure, axes


def _label_bars(axes: Axes, names: Sequence[str]) -> None:
    """Name horizontal bars, the first on top."""
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    _legend_below(axes)


def _legend_below(axes: Axes) -> None:
    axes.figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=9)


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
