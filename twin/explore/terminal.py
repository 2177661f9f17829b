"""What an exploration found, in a terminal."""

from __future__ import annotations

from pathlib import Path
from textwrap import shorten

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from twin.explore.folder import REPORT
from twin.explore.page_words import (
    BEST_HEAD,
    best_rows,
    importance_words,
    rung_rows,
    single_rows,
    verdict,
    worth_words,
)
from twin.explore.summary import ExploreSummary

_REASONS, _LONGEST = 6, 300
"""Reasons that are shown why designs are refused, and their letters."""


def print_explored(found: ExploreSummary, folder: Path) -> None:
    """Print the best designs and what they are worth, what matters, how far designs got, and where all is."""
    console = Console(highlight=False)
    goals = ", ".join(goal.words for goal in found.section.goals)
    title = f"{found.scenario}: {goals}, {found.tried} designs"
    if found.singles:
        head, rows = single_rows(found)
        console.print(_table(f"{title}: single changes that gain most", head, rows))
    elif found.ranked:
        head, rows = best_rows(found)
        console.print(_table(title, [*BEST_HEAD, *head], rows))
    else:
        console.print(Text(f"{title}: none is possible"), soft_wrap=True)
    for line in (*verdict(found), *worth_words(found), *importance_words(found)):
        console.print(Text(line), soft_wrap=True)
    head, rows = rung_rows(found)
    console.print(_table("how far designs got", head, rows))
    for item in found.refusals[:_REASONS]:
        console.print(
            f"[yellow]refused[/yellow] at {item.rung}: {item.count} x",
            Text(f"{shorten(item.reason, _LONGEST)} (design {item.design})"),
            soft_wrap=True,
        )
    if (more := len(found.refusals) - _REASONS) > 0:
        console.print(f"and {more} more reasons, in the report")
    console.print(f"{folder / REPORT}")


def _table(title: str, head: list[str], rows: list[list[str]]) -> Table:
    table = Table(
        title=Text(title), title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0)
    )
    for name in head:
        words = name in ("design", "rung", "kind")
        side = "left" if words else "right"
        table.add_column(Text(name), justify=side, overflow="fold")  # type: ignore[arg-type]
    for row in rows:
        table.add_row(*map(Text, row))
    return table
