"""What an exploration found, in a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from twin.explore.summary import ExploreSummary, RankedDesign

_BEST, _REASONS = 5, 6
"""Rows that are shown of the best designs, and of the reasons why others are refused."""


def print_explored(found: ExploreSummary, folder: Path) -> None:
    """Print the best designs, how far designs got, why they are refused, and where all is."""
    console = Console(highlight=False)
    goals = ", ".join(goal.words for goal in found.section.goals)
    title = f"{found.scenario}: {goals}, {found.tried} designs"
    shown = list(found.ranked[:_BEST])
    if found.base is not None and found.base not in shown:
        shown.append(found.base)
    if shown:
        console.print(best_table(title, found, shown))
    else:
        console.print(f"{title}: none is possible", soft_wrap=True)
    console.print(_rungs_table(found))
    for item in found.refusals[:_REASONS]:
        console.print(
            f"[yellow]refused[/yellow] at {item.rung}: {item.count} x",
            Text(f"{item.reason} (design {item.design})"),
            soft_wrap=True,
        )
    if (more := len(found.refusals) - _REASONS) > 0:
        console.print(f"and {more} more reasons, in summary.json")
    console.print(f"{folder}")


def best_table(
    title: str, found: ExploreSummary, shown: Sequence[RankedDesign]
) -> Table:
    """Return a table of designs: goals, mean makespan, and what they change."""
    table = _table(title)
    table.add_column("#", justify="right")
    for goal in found.section.goals:
        table.add_column(goal.expression.text, justify="right")
    table.add_column(Text("mean makespan [s]"), justify="right")
    table.add_column("design", overflow="fold")
    for item in shown:
        table.add_row(
            str(item.rank),
            *(f"{value:.4g}" for value in item.goals),
            interval_words(item),
            "; ".join(item.changes) or "the scenario as it is",
        )
    return table


def interval_words(item: RankedDesign) -> str:
    """Return the mean makespan of a design with its interval."""
    if item.mean_s is None:
        return "-"
    mean = item.mean_s
    return f"{mean.estimate:.2f} ({mean.low:.2f} to {mean.high:.2f})"


def _rungs_table(found: ExploreSummary) -> Table:
    table = _table("how far designs got")
    for name in ("rung", "came", "refused", "behind", "CPU s each"):
        table.add_column(name, justify="left" if name == "rung" else "right")
    for item in found.rungs:
        row = (item.came, item.refused, item.behind)
        table.add_row(item.rung, *map(str, row), f"{item.cpu_s:.2f}")
    return table


def _table(title: str) -> Table:
    return Table(
        title=Text(title),
        title_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
