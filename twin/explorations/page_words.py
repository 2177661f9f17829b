"""Results of a design exploration as text and table rows, for the terminal and the HTML report."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from textwrap import shorten

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from twin.explorations.finals import ChangeValue
from twin.explorations.folder import REPORT
from twin.explorations.section import REPLICATED
from twin.explorations.summary import ExploreSummary, RankedDesign
from twin.studies.replications.statistics import Interval

BEST_HEAD = ["#"]

_BEST = 5
"""Designs that are shown of the best ones, besides all compromises and the scenario as it is."""

_MATTER = 6
"""Keys that are shown of those that matter."""

_MEAN = "mean_s"
_SECONDS = ("makespan_s", "mean_s", "p50_s", "p90_s")

_REASONS, _LONGEST = 6, 300
"""Reasons that are shown why designs are refused, and their letters."""


def shown_designs(found: ExploreSummary) -> list[RankedDesign]:
    """Return the shown designs: the best, or the compromises, and the base design."""
    shown = list(found.compromises or found.ranked[:_BEST])
    if found.base is not None and found.base not in shown:
        shown.append(found.base)
    return shown


def best_rows(found: ExploreSummary) -> tuple[list[str], list[list[str]]]:
    """Return the head, behind the rank, and the rows of the table of the best designs."""
    goals = [goal.expression.text.strip() for goal in found.section.goals]
    finals = any(item.behind is not None for item in found.ranked)
    # Where it is a goal, its interval is in that column.
    apart = _MEAN not in goals
    head = [
        *goals,
        *(["mean makespan [s]"] if apart else []),
        *(["behind the best"] if finals else []),
        "design",
    ]
    rows = []
    for item in shown_designs(found):
        mean = "-" if item.mean_s is None else format_interval(item.mean_s)
        values = (f"{value:.5g}" for value in item.goals)
        words = zip(goals, values, strict=True)
        row = [str(item.rank), *(mean if goal == _MEAN else v for goal, v in words)]
        if apart:
            row.append(mean)
        if finals:
            row.append("" if item.behind is None else format_signed(item.behind))
        rows.append([*row, item.label])
    return head, rows


def rung_rows(found: ExploreSummary) -> tuple[list[str], list[list[str]]]:
    """Return the head and the rows of the table of rungs."""
    head = ["rung", "came", "refused", "behind", "CPU s each"]
    rows = [
        [r.rung, str(r.came), str(r.refused), str(r.behind), f"{r.cpu_s:.2f}"]
        for r in found.rungs
    ]
    return head, rows


def verdict(found: ExploreSummary) -> Iterator[str]:
    """Yield whether the best designs differ significantly."""
    if len(found.section.goals) > 1:
        yield from _compromise_words(found)
        return
    finals = [item for item in found.ranked if item.behind is not None]
    if not finals:
        return
    first = found.ranked[0]
    share = f"{100 * found.section.confidence:g} %"
    count = 0 if first.mean_s is None else first.mean_s.count
    same = ", ".join(f"#{item.rank}" for item in finals if not item.apart)
    with_ = f" after {count} new replications of each" if count else ""
    if same:
        yield f"#1 does not differ significantly from {same}{with_}, at {share}"
    else:
        yield f"#1 is better than the other finalists{with_}, at {share}"


def _compromise_words(found: ExploreSummary) -> Iterator[str]:
    """Yield the findings of new replications on the compromises of the search."""
    if not any(goal.expression.used & REPLICATED for goal in found.section.goals):
        return
    count = max((i.mean_s.count for i in found.compromises if i.mean_s), default=0)
    after = f"after {count} new replications, at {100 * found.section.confidence:g} %"
    if beaten := [f"#{item.rank}" for item in found.ranked if item.apart]:
        are = "is none: another one is" if len(beaten) == 1 else "are none: others are"
        yield f"of the compromises of the search {', '.join(beaten)} {are} better in every goal {after}"
    if unsure := [f"#{item.rank}" for item in found.ranked if item.unsure]:
        yield f"which of {', '.join(unsure)} are compromises is not known {after}"
    elif found.compromises and not beaten:
        yield f"all compromises of the search are such {after}"


def single_rows(found: ExploreSummary) -> tuple[list[str], list[list[str]]]:
    """Return the head and the rows of the table of single changes."""
    head = ["", "kind", "gain", "effort", "gain per effort", "design"]
    rows = [
        [
            str(rank),
            item.kind,
            format_signed(item.gain) + ("" if item.sure else ", may be nothing"),
            f"{item.effort:g}",
            f"{item.rate:.3g}",
            item.words,
        ]
        for rank, item in enumerate(found.singles, start=1)
    ]
    return head, rows


def describe_changes(found: ExploreSummary) -> Iterator[str]:
    """Yield the gains of changes of the best design."""
    goal = found.section.goals[0]
    text = goal.expression.text
    unit = " s" if text in _SECONDS else ""
    if found.ranked and found.ranked[0].design == 0 and not found.singles:
        yield "no design is better than the scenario as it is"
    for item in found.worths:
        subject = item.words if item.key else f"the best design ({item.words})"
        yield f"{subject} {_gain(item, text, unit)}"
        if (gain := item.by_plans) is not None:
            # The luck of one plan is not taken for what the design is worth.
            yield (
                f"over {gain.count} plans of either, each with another seed of the planner, it is worth"
                f" {format_interval(gain)}{unit} of {text}{_doubt(gain)}"
            )


def _gain(item: ChangeValue, text: str, unit: str) -> str:
    if item.gain is None:
        return f"is needed: without it refused at {item.reason}"
    gain = item.gain
    worth = (
        f"is worth {_fixed(gain.estimate)}{unit}"
        if unit
        else f"is worth {gain.estimate:.4g}"
    )
    if gain.low == gain.high or not (bounds := gain.bounds(_fixed)):
        return f"{worth} of {text}"
    return f"{worth} ({bounds}) of {text}{_doubt(gain)}"


def _doubt(gain: Interval) -> str:
    return " (it may be nothing)" if gain.low <= 0.0 <= gain.high else ""


def describe_importances(found: ExploreSummary) -> Iterator[str]:
    """Yield the importances for the first goal, in a line."""
    words = [
        f"{item.key} {100 * item.share.estimate:.0f} %"
        f" ({100 * item.share.low:.0f} to {100 * item.share.high:.0f})"
        for item in found.importances[:_MATTER]
    ]
    if words:
        yield f"what differences go with: {', '.join(words)}"


def format_interval(found: Interval) -> str:
    """Return an estimate with its interval."""
    bounds = found.bounds(_fixed)
    return f"{_fixed(found.estimate)} ({bounds})" if bounds else _fixed(found.estimate)


def _fixed(value: float) -> str:
    """Return a number to two digits, without a sign if it rounds to zero."""
    return f"{round(value, 2) + 0.0:.2f}"


def format_signed(found: Interval) -> str:
    """Return a difference with its interval."""
    bounds = found.bounds("{:+.3g}".format)
    if found.low == found.high or not bounds:
        return f"{found.estimate:+.4g}"
    return f"{found.estimate:+.3g} ({bounds})"


def print_explored(found: ExploreSummary, folder: Path) -> None:
    """Print the best designs and their gains, importances, rungs, and the folder."""
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
    for line in (
        *verdict(found),
        *describe_changes(found),
        *describe_importances(found),
    ):
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
