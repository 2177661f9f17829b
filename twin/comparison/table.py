"""Terminal tables of a comparison."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from twin.comparison.comparison import BASELINES, STAGES, TOTAL

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
