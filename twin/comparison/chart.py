"""Bar charts of comparisons, in the manner of APEX-MR Figs. 7 and 8.

Terminal tables of a comparison.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from rich.console import Console
from rich.table import Table

from twin.comparison.comparison import BASELINES, COMPARED, STAGES, TOTAL
from twin.host.pictures import INK, save_png, style_axes
from twin.run.policies import ASYNCHRONOUS, SEQUENTIAL

Figures = Mapping[str, Mapping[str, Any]]
"""The figures of one scenario, as in ``compare.json``."""

_COLOURS = ("#9aa3ad", "#f2b56b", "#d97b29", "#9c4a12", "#6fa8dc", "#1f5f9e")
_STAGE_STYLE = {
    "sequence": ("#5b4a8a", "assembly sequence"),
    "assignment": ("#a99bd0", "who does what"),
    "motion": ("#8ecdb8", "motions in turn"),
    "synchronous": ("#e3c64e", "slots"),
    "tpg": ("#2f7f66", "what waits for what"),
    "shortcut": ("#c4566f", "shortcuts"),
}
_BOUNDS: dict[str, tuple[Literal["-", ":"], str]] = {
    "critical_path_s": ("-", "critical path of the tasks"),
    "straight_line_s": (":", "busiest robot, straight lines"),
}
_STEP = 0.86 / len(COMPARED)
"""Distance of bars; groups are 1 apart."""

_BAR = 0.92 * _STEP


def draw_comparison(
    path: Path,
    scenarios: Mapping[str, Figures],
    title: str,
    clock: str = "wall-clock time",
) -> None:
    """Draw makespan, wait and planning time of every policy as a PNG picture.

    One scenario is drawn in seconds. Several are drawn as shares: makespan and wait of the
    sequential makespan, planning of what the asynchronous plan without shortcuts takes; the
    seconds are written at the bars. Whiskers are standard deviations over the seeds.

    Args:
        path: of the picture, replaced when it exists.
        scenarios: for each name the figures of ``compare.json``.
        title: first line of the heading.
        clock: what planning was measured by.

    Raises:
        OutputError: the picture cannot be written.
    """
    alone = len(scenarios) == 1
    width, height = (14.0, 5.6) if alone else (max(9.0, 1.2 + 1.9 * len(scenarios)), 11)
    picture = Figure(figsize=(width, height), dpi=120, facecolor="white")
    panels = picture.subplots(*((1, 3) if alone else (3, 1)))
    edges = {"left": 0.7 / width, "right": 1 - 0.2 / width, "wspace": 0.2}
    picture.subplots_adjust(**edges, top=1 - 1.5 / height, hspace=0.38)
    picture.subplots_adjust(bottom=(1.15 if alone else 0.75) / height)
    at, font = (0.7 / width, 1 - 0.38 / height), {"size": 13, "weight": "bold"}
    picture.text(*at, title, fontdict=font, color=INK)
    for axis, key, label in (
        (panels[0], "makespan_s", "makespan"),
        (panels[1], "wait_s", "wait, all robots together"),
    ):
        scale = [
            1.0 if alone else _mean(f[SEQUENTIAL]["makespan_s"])
            for f in scenarios.values()
        ]
        _draw_bars(axis, scenarios, key, scale)
        _style(axis, scenarios, label, "s" if alone else "% of the sequential makespan")
    stages = _draw_stages(panels[2], scenarios, alone=alone)
    unit = "s" if alone else "% of asynchronous"
    _style(panels[2], scenarios, f"planning, {clock}", unit)
    bars = [Patch(color=c, label=n) for n, c in zip(COMPARED, _COLOURS, strict=True)]
    rows = (1 - 0.8 / height, 1 - 1.06 / height)
    if alone:
        _legend(picture, [*bars, *_bound_marks()], y=rows[0])
        _legend(picture, stages, y=rows[1])
    else:
        _legend(picture, bars, y=rows[0])
        _legend(picture, _bound_marks(), y=rows[1])
        _legend(picture, stages, y=0.12 / height)
    save_png(picture, path)


def _draw_bars(
    axis: Axes, scenarios: Mapping[str, Figures], key: str, scale: Sequence[float]
) -> None:
    """Draw one figure of every policy and scenario, with its spread and its bounds."""
    for group, (figures, unit) in enumerate(
        zip(scenarios.values(), scale, strict=True)
    ):
        factor = 1.0 if len(scenarios) == 1 else 100.0
        for k, name in enumerate(COMPARED):
            x, own = _place(group, k), figures[name]
            mean, std = _mean(own[key]), own[key]["std"] or 0.0
            axis.bar(x, factor * mean / unit, _BAR, color=_COLOURS[k])
            if std:
                at, by = factor * mean / unit, factor * std / unit
                axis.errorbar(
                    x, at, by, fmt="none", ecolor=INK, elinewidth=0.9, capsize=2
                )
            _write(axis, x, factor * (mean + std) / unit, f"{mean:.0f}")
            if key == "makespan_s":
                for bound, (style, _) in _BOUNDS.items():
                    level = factor * _mean(own[bound]) / unit
                    ends = (x - 0.42 * _STEP, x + 0.42 * _STEP)
                    axis.plot(ends, (level, level), color="white", lw=2.6)
                    axis.plot(ends, (level, level), style, color=INK, lw=1.3)


def _draw_stages(
    axis: Axes, scenarios: Mapping[str, Figures], *, alone: bool
) -> list[Artist]:
    """Draw stacked planning times; return what to show in the legend."""
    used: dict[str, Artist] = {}
    for group, figures in enumerate(scenarios.values()):
        unit = 1.0 if alone else _mean(figures[ASYNCHRONOUS]["planning_s"][TOTAL]) / 100
        for k, name in enumerate(COMPARED):
            x, bottom = _place(group, k), 0.0
            spent = figures[name]["planning_s"]
            for stage in STAGES:
                if stage not in spent:
                    continue
                share = _mean(spent[stage]) / unit
                colour, label = _STAGE_STYLE[stage]
                axis.bar(x, share, _BAR, bottom=bottom, color=colour)
                used.setdefault(stage, Patch(color=colour, label=label))
                bottom += share
            _write(axis, x, bottom, _short(_mean(spent[TOTAL])))
    return [used[stage] for stage in STAGES if stage in used]


def _style(axis: Axes, scenarios: Mapping[str, Figures], title: str, unit: str) -> None:
    style_axes(axis, grid="y")
    axis.tick_params(length=0)
    axis.set_title(title, loc="left", fontsize=10, color=INK, pad=8)
    axis.set_ylabel(unit, fontsize=8.5, color=INK)
    axis.set_xlim(-0.55, len(scenarios) - 0.45)
    if len(scenarios) == 1:
        places = [_place(0, k) for k in range(len(COMPARED))]
        axis.set_xticks(places, COMPARED, fontsize=7.5, color=INK)
        for text in axis.get_xticklabels():
            text.set(rotation=28, ha="right", rotation_mode="anchor")
    else:
        axis.set_xticks(range(len(scenarios)), scenarios, fontsize=9, color=INK)
    axis.tick_params(axis="y", labelsize=8)
    axis.margins(y=0.14)
    axis.set_ylim(bottom=0)


def _write(axis: Axes, x: float, y: float, text: str) -> None:
    axis.annotate(
        text,
        (x, y),
        xytext=(0, 3),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=7,
        color=INK,
    )


def _legend(picture: Figure, entries: Sequence[Artist], y: float) -> None:
    picture.legend(
        handles=list(entries),
        loc="lower left",
        bbox_to_anchor=(0.7 / picture.get_figwidth(), y),
        ncols=len(entries),
        frameon=False,
        fontsize=8,
        labelcolor=INK,
        handlelength=1.1,
        handletextpad=0.5,
        columnspacing=1.3,
        borderaxespad=0,
        borderpad=0,
    )


def _bound_marks() -> list[Artist]:
    return [
        Line2D([], [], color=INK, linestyle=style, linewidth=1.3, label=label)
        for style, label in _BOUNDS.values()
    ]


def _place(group: int, k: int) -> float:
    return group + (k - (len(COMPARED) - 1) / 2) * _STEP


def _short(seconds: float) -> str:
    return f"{seconds:.2g}" if seconds < 10 else f"{seconds:.0f}"


def _mean(value: Mapping[str, Any]) -> float:
    return float(value["mean"])


_STAGE_NAMES = {
    "sequence": "sequence",
    "assignment": "tasks",
    "motion": "motions",
    "synchronous": "slots",
    "tpg": "TPG",
    "shortcut": "shortcuts",
    TOTAL: "total",
}
_WIDE = 136
"""Columns that the tables need to show deviations and headings in full."""


def print_comparison(
    figures: Mapping[str, Mapping[str, Any]],
    folder: Path,
    *,
    heading: str,
    compiled: bool = False,
) -> None:
    """Print the figures of a comparison to standard output.

    Args:
        figures: the content of ``compare.json``.
        folder: where it is.
        heading: of the table.
        compiled: whether kernels were compiled in the planning stages.
    """
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, _WIDE)
    wide = console.width >= _WIDE
    console.print(_quality(figures, heading, wide=wide))
    console.print(_planning(figures, compiled=compiled, wide=wide))
    for name in BASELINES:
        ratio = figures[name]["straight_line_ratio"]
        if ratio is not None:
            console.print(
                f"the {name} plan takes {ratio['mean']:.3f} times as long as with straight"
                f" transits (at most {max(ratio['per_seed']):.3f})",
                soft_wrap=True,
            )
    console.print(f"results: {folder}", soft_wrap=True)


def _quality(
    figures: Mapping[str, Mapping[str, Any]], heading: str, *, wide: bool
) -> Table:
    table = Table(title=heading, title_justify="left")
    table.add_column("seconds", style="bold", no_wrap=wide)
    share = "of sequential" if wide else "%"
    bounds = ("least, straight", "least, tasks") if wide else ("straight", "tasks")
    for column in ("makespan", share, *bounds, "wait", share):
        table.add_column(column, justify="right", no_wrap=True)
    value = spread if wide else mean
    for name, row in figures.items():
        table.add_row(
            name,
            value(row["makespan_s"]),
            percent(row["relative_makespan"]),
            mean(row["straight_line_s"]),
            mean(row["critical_path_s"]),
            value(row["wait_s"]),
            percent(row["relative_wait"]),
        )
    return table


def _planning(
    figures: Mapping[str, Mapping[str, Any]], *, compiled: bool, wide: bool
) -> Table:
    used = [
        s
        for s in (*STAGES, TOTAL)
        if any(s in row["planning_s"] for row in figures.values())
    ]
    remark = ", the first seed with compiling" if compiled else ""
    table = Table(title=f"planning{remark}", title_justify="left")
    table.add_column("seconds", style="bold", no_wrap=wide)
    for stage in used:
        table.add_column(_STAGE_NAMES[stage], justify="right", no_wrap=True)
    value = spread if wide else mean
    for name, row in figures.items():
        cells = [row["planning_s"].get(stage) for stage in used]
        table.add_row(name, *(value(cell, 2) if cell else "" for cell in cells))
    return table


def mean(value: Mapping[str, Any] | None, digits: int = 1) -> str:
    """Return the mean of a figure as text, a dash where there is none."""
    return "-" if value is None else f"{value['mean']:.{digits}f}"


def spread(value: Mapping[str, Any] | None, digits: int = 1) -> str:
    """Return mean and standard deviation of a figure as text."""
    if value is None or value["std"] is None:
        return mean(value, digits)
    return f"{value['mean']:.{digits}f} ± {value['std']:.{digits}f}"


def percent(value: Mapping[str, Any] | None) -> str:
    """Return the mean of a relative figure in percent."""
    return "-" if value is None else f"{100 * value['mean']:.1f} %"
