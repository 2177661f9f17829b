"""A comparison as a table for people."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from twin.comparison import BASELINES
from twin.comparison_figures import STAGES, TOTAL

_STAGE_NAMES = {
    "sequence": "sequence",
    "assignment": "who does what",
    "motion": "motions",
    "synchronous": "slots",
    "tpg": "what waits for what",
    "shortcut": "shortcuts",
    TOTAL: "total",
}


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
        console.width = max(console.width, 140)
    console.print(_quality(figures, heading))
    console.print(_planning(figures, compiled=compiled))
    for name in BASELINES:
        ratio = figures[name]["straight_line_ratio"]
        if ratio is not None:
            console.print(
                f"the {name} plan takes {ratio['mean']:.3f} times as long as with straight"
                f" transits (at most {max(ratio['per_seed']):.3f})",
                soft_wrap=True,
            )
    console.print(f"results: {folder}", soft_wrap=True)


def _quality(figures: Mapping[str, Mapping[str, Any]], heading: str) -> Table:
    table = Table(title=heading, title_justify="left")
    table.add_column("", style="bold", no_wrap=True)
    for column in (
        "makespan, s",
        "of sequential",
        "bound: straight, s",
        "bound: tasks, s",
        "wait, s",
        "of sequential",
    ):
        table.add_column(column, justify="right")
    for name, row in figures.items():
        table.add_row(
            name,
            spread(row["makespan_s"]),
            percent(row["relative_makespan"]),
            mean(row["straight_line_s"]),
            mean(row["critical_path_s"]),
            spread(row["wait_s"]),
            percent(row["relative_wait"]),
        )
    return table


def _planning(figures: Mapping[str, Mapping[str, Any]], *, compiled: bool) -> Table:
    used = [
        s
        for s in (*STAGES, TOTAL)
        if any(s in row["planning_s"] for row in figures.values())
    ]
    remark = ", the first seed with compiling" if compiled else ""
    table = Table(title=f"planning, s{remark}", title_justify="left")
    table.add_column("", style="bold", no_wrap=True)
    for stage in used:
        table.add_column(_STAGE_NAMES[stage], justify="right")
    for name, row in figures.items():
        cells = [row["planning_s"].get(stage) for stage in used]
        table.add_row(name, *(spread(cell, 2) if cell else "" for cell in cells))
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
