"""Gantt chart of a run, with one lane per robot; the time axis is wrapped into several rows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from planning.tasks.task import TaskKind
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.windows import window_nodes
from twin.activities.activities import (
    HOLDING,
    WAITING,
    Activity,
    part_names,
    robot_activities,
)
from twin.drawing.lane_colours import plan_colours
from twin.drawing.pictures import INK, style_axes, wrap_name
from twin.drawing.team_colours import team_colours
from twin.durations.nanoseconds import NANOSECONDS
from twin.runs.events import Event
from twin.runs.execution_record import ExecutionRecord
from twin.runs.policies import IN_TURNS, policy_name
from twin.runs.windows import window_summary

_TASKS_A_ROW = 36
"""Tasks of a lane in a row: their parts can be read."""

_MOST_LANES = 96
"""Largest number of lanes in all rows; further rows are omitted."""
_MARGIN = 1.012
"""Length of all rows over that of the run: the line at its end is to be seen."""
_WIDTH_IN = 15.0
_LANE_IN = 0.42
_LANE_HEIGHT = 0.72
_NAME_SIZE, _NAME_LINES = 6.0, 3
"""Size of the names of parts [points], and lines of them in a bar."""


def gantt_figure(
    tpg: TemporalPlanGraph,
    run: ExecutionRecord,
    events: Sequence[Event],
    *,
    title: str = "",
    plan: str = IN_TURNS,
) -> Figure:
    """Return a Gantt chart of a run.

    Bars are coloured by kind of task and carry the part that they are about, or the number of the
    product where there are several; waits are hatched, and arrows are the type-2 edges that ended them. Long
    runs wrap into several rows. A line over a lane marks an open time window, red where it was
    exceeded; a dotted one marks replanning. Next to its lane each robot has its colour in the
    recording.

    Args:
        tpg: the executed plan.
        run: how.
        events: of the run.
        title: first words of the heading.
        plan: which plan ``tpg`` is.
    """
    lanes = _lanes(tpg, events)
    total_s = max(run.makespan_s, 1e-9)
    rows, row_s = _wrapped(lanes, total_s)
    shown_s = min(rows * row_s, total_s)
    figure, axes = _empty_rows(rows, len(lanes))
    links = _binding_edges(tpg, run, list(lanes))
    windows = list(_windows(tpg, run, list(lanes)))
    for row, axis in enumerate(axes):
        window = (row * row_s, (row + 1) * row_s)
        _style(axis, list(lanes), window)
        for k, lane in enumerate(lanes.values()):
            _draw_lane(axis, tpg, k, lane, window)
        for t_s, start, end in links:
            if window[0] <= t_s < window[1]:
                _draw_arrow(axis, t_s, start, end)
        for number, opened_s, due_s, broken in windows:
            _draw_window(axis, (number, opened_s, due_s), window, broken=broken)
        if window[0] <= total_s <= window[1]:
            axis.axvline(total_s, color=INK, lw=1.2)
        for event in events:
            at_s = event.t_ns / NANOSECONDS
            if event.kind == "replanned" and window[0] <= at_s < window[1]:
                axis.axvline(at_s, color=INK, lw=1.0, ls=":")
    axes[-1].set_xlabel("time [s]", color=INK, fontsize=9)
    heading = f"{title}   " if title else ""
    figure.text(
        0.075,
        1 - 0.36 / figure.get_figheight(),
        f"{heading}{policy_name(plan, run.policy)}, "
        + ("makespan" if run.outcome == "completed" else f"{run.outcome} after")
        + f" {run.makespan_s:.2f} s"
        + (f" (the first {shown_s:.0f} s)" if shown_s < total_s else ""),
        color=INK,
        fontsize=12,
        fontweight="bold",
    )
    seen = {item.state for lane in lanes.values() for item in lane}
    _legend(figure, seen, plan_colours(tpg))
    return figure


def _lanes(
    tpg: TemporalPlanGraph, events: Sequence[Event]
) -> dict[str, tuple[Activity, ...]]:
    """Return the activities of each robot, and of each machine with a task."""
    words = robot_activities(tpg, events)
    tasks = {task.kind for task in tpg.tasks}
    lanes = {robot.name: words.get(robot.name, ()) for robot in tpg.cell.robots}
    return lanes | {
        name: words[name]
        for name in (item.name for item in tpg.cell.machines)
        if any(item.state in tasks for item in words.get(name, ()))
    }


def _wrapped(
    lanes: Mapping[str, Sequence[Activity]], total_s: float
) -> tuple[int, float]:
    """Return the number of rows of a chart and the duration of each [s].

    A lane of a row has few enough tasks to be read. Rows beyond the most lanes are left out.
    """
    tasks = [len({item.task for item in lane}) for lane in lanes.values()]
    rows = max(1, -(-max(tasks, default=0) // _TASKS_A_ROW))
    row_s = total_s * _MARGIN / rows
    if rows * len(lanes) > _MOST_LANES:
        rows = max(1, _MOST_LANES // len(lanes))
    return rows, row_s


def _empty_rows(rows: int, lanes: int) -> tuple[Figure, Sequence[Axes]]:
    """Return a figure with room for a heading, a legend and rows of lanes."""
    height = rows * (lanes * _LANE_IN + 0.42) + 1.25
    figure = Figure(figsize=(_WIDTH_IN, height), dpi=130, facecolor="white")
    axes = figure.subplots(
        rows,
        1,
        squeeze=False,
        gridspec_kw={
            "left": 0.075,
            "right": 0.985,
            "top": 1 - 0.62 / height,
            "bottom": (0.62 + 0.32) / height,
            "hspace": 0.42 / (lanes * _LANE_IN),
        },
    )
    return figure, axes[:, 0].tolist()


def _style(axis: Axes, robots: Sequence[str], window: tuple[float, float]) -> None:
    axis.set_xlim(*window)
    axis.set_ylim(len(robots) - 0.5, -0.5)
    axis.set_yticks(range(len(robots)), robots)
    style_axes(axis, grid="x")
    axis.tick_params(axis="x", labelsize=8, length=3)
    axis.tick_params(axis="y", length=0, pad=12)
    for k, colour in enumerate(team_colours(robots).values()):
        swatch = Rectangle((-0.0085, k - _LANE_HEIGHT / 2), 0.0055, _LANE_HEIGHT)
        swatch.set(
            facecolor=colour, transform=axis.get_yaxis_transform(), clip_on=False
        )
        axis.add_patch(swatch)


def _draw_lane(
    axis: Axes,
    tpg: TemporalPlanGraph,
    k: int,
    lane: Sequence[Activity],
    window: tuple[float, float],
) -> None:
    colours, names = plan_colours(tpg), part_names(tpg)
    point_s = (window[1] - window[0]) / (_WIDTH_IN * 0.91 * 72)
    bars: dict[str, list[tuple[float, float]]] = {}
    for span in lane:
        start, end = span.start_ns / NANOSECONDS, span.end_ns / NANOSECONDS
        low, high = max(start, window[0]), min(end, window[1])
        if high <= low:
            continue
        bars.setdefault(span.state, []).append((low, high - low))
        label = wrap_name(
            _label(tpg, names, span),
            (high - low) / point_s - 1.5,
            _NAME_SIZE,
            lines=_NAME_LINES,
        )
        if label:
            bright = np.dot(to_rgb(colours[span.state]), (0.299, 0.587, 0.114))
            axis.text(
                0.5 * (low + high),
                k,
                label,
                ha="center",
                va="center",
                fontsize=_NAME_SIZE,
                linespacing=1.0,
                color="white" if bright < 0.55 else INK,
            )
    for state, spans in bars.items():
        waits = state == WAITING
        axis.broken_barh(
            spans,
            (k - _LANE_HEIGHT / 2, _LANE_HEIGHT),
            facecolor="white" if waits else colours[state],
            edgecolor="#9aa3ad" if waits else "white",
            hatch="//////" if waits else None,
            lw=0.0 if waits else 0.4,
        )


def _label(tpg: TemporalPlanGraph, names: Sequence[str], span: Activity) -> str:
    """Return the part of a skill, or the number of the product of several.

    Motions and waits carry none.
    """
    if span.task < 0 or span.state in (TaskKind.TRANSIT, TaskKind.STRAIGHT):
        return ""
    if span.state not in (tpg.tasks[span.task].kind, HOLDING):
        return ""
    product = tpg.products[span.task] if len(tpg.products) else 0
    return f"product {product}" if product else names[span.task]


def _binding_edges(
    tpg: TemporalPlanGraph, run: ExecutionRecord, robots: Sequence[str]
) -> list[tuple[float, int, int]]:
    """Return the time [s] and both lanes of the type-2 edges whose source ended a wait.

    Of the nodes that a robot waited for it is the last that was complete, and those of the same
    time; the robot may set off later: messages take time, and so does speeding up.
    """
    lane_of = {robot: k for k, robot in enumerate(robots)}
    waits = {(w.chain, w.node): w for w in run.waits()}
    last_ns: dict[tuple[int, int], int] = {}
    found = []
    for a, m, b, n in tpg.edges.tolist():
        end_ns, wait = int(run.end_ns[a][m]), waits.get((b, n))
        if wait is None or not wait.start_ns < end_ns <= wait.end_ns:
            continue
        last_ns[b, n] = max(end_ns, last_ns.get((b, n), 0))
        lanes = lane_of.get(tpg.chains[a].robot), lane_of.get(tpg.chains[b].robot)
        found.append((end_ns, (b, n), lanes))
    return [
        (end_ns / NANOSECONDS, source, target)
        for end_ns, node, (source, target) in found
        if end_ns == last_ns[node] and source is not None and target is not None
    ]


def _draw_arrow(axis: Axes, t_s: float, start: int, end: int) -> None:
    reach = _LANE_HEIGHT / 2 if end > start else -_LANE_HEIGHT / 2
    axis.annotate(
        "",
        xy=(t_s, end - reach),
        xytext=(t_s, start + reach),
        arrowprops={
            "arrowstyle": "-|>",
            "lw": 0.7,
            "color": "#5c6570",
            "mutation_scale": 6,
            "shrinkA": 0,
            "shrinkB": 0,
        },
    )


def _windows(
    tpg: TemporalPlanGraph, run: ExecutionRecord, robots: Sequence[str]
) -> Iterator[tuple[int, float, float, bool]]:
    """Yield for each time window the lane of its due task, opening and due time [s], and whether it is broken.

    Those without a greatest time, and those that did not come to their end, are left out.
    """
    chain = np.repeat(np.arange(len(tpg.chains)), [len(own) for own in tpg.chains])
    rows = window_nodes(tpg)[:, 2].tolist()
    for words, due in zip(window_summary(tpg, run), rows, strict=True):
        name = tpg.chains[chain[due]].robot
        if words["slack_s"] is not None and name in robots:
            begun_s = int(np.concatenate(run.start_ns)[due]) / NANOSECONDS
            due_s = begun_s + words["slack_s"]
            opened_s = begun_s - words["passed_s"]
            yield robots.index(name), opened_s, due_s, words["broken"]


def _draw_window(
    axis: Axes,
    at: tuple[int, float, float],
    shown: tuple[float, float],
    *,
    broken: bool,
) -> None:
    """Draw a line over a lane for as long as a window is open, red where it is broken."""
    lane, opened_s, due_s = at
    low, high = max(opened_s, shown[0]), min(due_s, shown[1])
    if high > low:
        colour = "#c0392b" if broken else "#2e7d32"
        axis.plot([low, high], [lane - 0.46] * 2, color=colour, lw=2.0)


def _legend(figure: Figure, seen: set[str], colours: Mapping[str, str]) -> None:
    states = [s for s in colours if s in seen]
    handles = [
        Patch(facecolor="white", edgecolor="#9aa3ad", hatch="//////", label=s)
        if s == WAITING
        else Patch(facecolor=colours[s], label=s)
        for s in states
    ]
    figure.legend(
        handles=handles,
        loc="lower center",
        ncols=max(len(handles), 1),
        frameon=False,
        fontsize=8.5,
        handlelength=1.4,
        labelcolor=INK,
    )
