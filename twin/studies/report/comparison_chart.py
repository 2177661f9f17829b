"""Bar chart and terminal tables of a comparison of policies, in the style of APEX-MR Figs. 7 and 8."""

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

from twin.drawing.pictures import INK, style_axes
from twin.host.atomic_files import save_png
from twin.runs.policies import ASYNCHRONOUS, SEQUENTIAL
from twin.studies.comparison import BASELINES, COMPARED, STAGES, TOTAL

Figures = Mapping[str, Mapping[str, Any]]
"""The figures of one scenario, the content of ``compare.json``."""

_COLOURS = ("#9aa3ad", "#f2b56b", "#d97b29", "#9c4a12", "#6fa8dc", "#1f5f9e")
_STAGE_STYLE = {
    "sequence": ("#5b4a8a", "assembly sequence", "sequence"),
    "assignment": ("#a99bd0", "who does what", "tasks"),
    "motion": ("#8ecdb8", "motions in turn", "motions"),
    "assignment_search": ("#7fa3c7", "shorter assignment", "search"),
    "synchronous": ("#e3c64e", "slots", "slots"),
    "tpg": ("#2f7f66", "what waits for what", "TPG"),
    "shortcut": ("#c4566f", "shortcuts", "shortcuts"),
    TOTAL: ("", "", "total"),
}
"""Colour, name in the chart and heading in the table of each stage of planning."""

_BOUNDS: dict[str, tuple[Literal["-", ":"], str]] = {
    "critical_path_s": ("-", "critical path of the tasks"),
    "straight_line_s": (":", "busiest robot, straight lines"),
}
_STEP = 0.86 / len(COMPARED)
"""Distance of bars; groups are 1 apart."""

_BAR = 0.92 * _STEP

_WIDE = 136
"""Columns that the tables need to show deviations and headings in full."""


def draw_comparison(
    path: Path,
    scenarios: Mapping[str, Figures],
    title: str,
    clock: str = "wall-clock time",
) -> None:
    """Draw makespan, wait and planning time of every policy as a PNG picture.

    One scenario is drawn in seconds. Several are drawn as shares: makespan and wait of the
    sequential makespan, planning of the asynchronous plan without shortcuts; the seconds are
    written at the bars. Whiskers are standard deviations over the seeds.

    Args:
        path: of the picture, replaced when it exists.
        scenarios: for each name the figures of ``compare.json``.
        title: first line of the heading.
        clock: clock of the planning times.

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
    unit = "s" if alone else "% of the sequential makespan"
    for axis, key, label in (
        (panels[0], "makespan_s", "makespan"),
        (panels[1], "wait_s", "wait, all robots together"),
    ):
        _draw_bars(axis, scenarios, key)
        _style(axis, scenarios, label, unit)
    stages = _draw_stages(panels[2], scenarios)
    unit = "s" if alone else "% of asynchronous"
    _style(panels[2], scenarios, f"planning, {clock}", unit)
    bars = [Patch(color=c, label=n) for n, c in zip(COMPARED, _COLOURS, strict=True)]
    bounds = [
        Line2D([], [], color=INK, linestyle=style, linewidth=1.3, label=label)
        for style, label in _BOUNDS.values()
    ]
    rows: Sequence[Sequence[Artist]] = (
        ([*bars, *bounds], stages) if alone else (bars, bounds, stages)
    )
    levels = (1 - 0.8 / height, 1 - 1.06 / height, 0.12 / height)
    for entries, y in zip(rows, levels, strict=False):
        _legend(picture, entries, y)
    save_png(picture, path)


def _draw_bars(axis: Axes, scenarios: Mapping[str, Figures], key: str) -> None:
    """Draw one figure of every policy and scenario, with its spread and its bounds."""
    for group, figures in enumerate(scenarios.values()):
        scale = 1.0
        if len(scenarios) > 1:
            scale = 100.0 / figures[SEQUENTIAL]["makespan_s"]["mean"]
        for k, name in enumerate(COMPARED):
            x, own = _place(group, k), figures[name]
            value, spread_s = own[key]["mean"], own[key]["std"]
            axis.bar(x, scale * value, _BAR, color=_COLOURS[k])
            if spread_s:
                error: dict[str, Any] = {
                    "fmt": "none",
                    "ecolor": INK,
                    "elinewidth": 0.9,
                    "capsize": 2,
                }
                axis.errorbar(x, scale * value, scale * spread_s, **error)
            _write(axis, x, scale * (value + (spread_s or 0.0)), f"{value:.0f}")
            for bound, (style, _) in _BOUNDS.items() if key == "makespan_s" else ():
                level = (scale * own[bound]["mean"],) * 2
                ends = (x - 0.42 * _STEP, x + 0.42 * _STEP)
                axis.plot(ends, level, color="white", lw=2.6)
                axis.plot(ends, level, style, color=INK, lw=1.3)


def _draw_stages(axis: Axes, scenarios: Mapping[str, Figures]) -> list[Artist]:
    """Draw stacked planning times; return what to show in the legend."""
    used: dict[str, Artist] = {}
    for group, figures in enumerate(scenarios.values()):
        unit = 1.0
        if len(scenarios) > 1:
            unit = figures[ASYNCHRONOUS]["planning_s"][TOTAL]["mean"] / 100
        for k, name in enumerate(COMPARED):
            x, bottom = _place(group, k), 0.0
            spent = figures[name]["planning_s"]
            for stage in (stage for stage in STAGES if stage in spent):
                share = spent[stage]["mean"] / unit
                colour, label, _ = _STAGE_STYLE[stage]
                axis.bar(x, share, _BAR, bottom=bottom, color=colour)
                used.setdefault(stage, Patch(color=colour, label=label))
                bottom += share
            total = spent[TOTAL]["mean"]
            _write(axis, x, bottom, f"{total:.2g}" if total < 10 else f"{total:.0f}")
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
    above: dict[str, Any] = {"xytext": (0, 3), "textcoords": "offset points"}
    align: dict[str, Any] = {
        "ha": "center",
        "va": "bottom",
        "fontsize": 7,
        "color": INK,
    }
    axis.annotate(text, (x, y), **above, **align)


def _legend(picture: Figure, entries: Sequence[Artist], y: float) -> None:
    style = {"frameon": False, "fontsize": 8, "labelcolor": INK}
    spaces = {"handlelength": 1.1, "handletextpad": 0.5, "columnspacing": 1.3}
    picture.legend(
        handles=list(entries),
        loc="lower left",
        bbox_to_anchor=(0.7 / picture.get_figwidth(), y),
        ncols=len(entries),
        borderaxespad=0,
        borderpad=0,
        **style,
        **spaces,
    )


def _place(group: int, k: int) -> float:
    """Return the position of a policy's bar."""
    return group + (k - (len(COMPARED) - 1) / 2) * _STEP


def print_comparison(
    figures: Figures, folder: Path, *, heading: str, compiled: bool = False
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
    value, share = (spread, "of sequential") if wide else (mean, "%")
    bounds = ("least, straight", "least, tasks") if wide else ("straight", "tasks")
    table = _table(heading, ("makespan", share, *bounds, "wait", share), wide=wide)
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
    console.print(table)
    spent = {name: row["planning_s"] for name, row in figures.items()}
    used = [s for s in _STAGE_STYLE if any(s in own for own in spent.values())]
    remark = ", the first seed with compiling" if compiled else ""
    names = [_STAGE_STYLE[stage][2] for stage in used]
    table = _table(f"planning{remark}", names, wide=wide)
    for name, own in spent.items():
        table.add_row(name, *(value(own[s], 2) if s in own else "" for s in used))
    console.print(table)
    for name in BASELINES:
        ratio = figures[name]["straight_line_ratio"]
        if ratio is not None:
            console.print(
                f"the {name} plan takes {ratio['mean']:.3f} times as long as with straight"
                f" transits (at most {max(ratio['per_seed']):.3f})",
                soft_wrap=True,
            )
    console.print(f"results: {folder}", soft_wrap=True)


def _table(title: str, columns: Sequence[str], *, wide: bool) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column("seconds", style="bold", no_wrap=wide)
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
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
