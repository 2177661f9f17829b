"""Terminal table of the figures of a study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from twin.study.folder import REPORT
from twin.study.layouts import words
from twin.study.replications.statistics import Interval
from twin.study.report.fixing import LESS, P90, busy_rows
from twin.study.report.lines import line_rows
from twin.study.report.ranking import behind_words, ranking_rows, told_apart
from twin.study.report.report import shown_cell, shown_policy
from twin.study.study import StudyResult
from twin.study.tables import cell_label, collisions

_TOP = ((True, 2), (False, 3))
"""Rows of what is worth fixing: many things at once, and one thing each."""


def print_study(result: StudyResult) -> None:
    """Print makespans with their intervals, differences between policies, and where all is."""
    console = Console(highlight=False)
    if result.summary["ranking"]:
        _print_ranking(console, result.summary, result.request.experiment.policies)
    else:
        _print_makespans(console, result.summary)
    _print_rest(console, result)


def _print_makespans(console: Console, summary: Mapping[str, Any]) -> None:
    """Print the makespans of all policies and variants, and how policies differ."""
    share = f"{100 * summary['confidence']:g} %"
    table = Table(
        title=f"{summary['scenario']}: makespan in seconds, {share} intervals",
        title_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    varied = list(summary["cells"][0]["variant"])
    for name in ("policy", *varied):
        table.add_column(name, overflow="fold", min_width=min(len(name), 12))
    broken = any(cell["not_completed"]["estimate"] for cell in summary["cells"])
    names = ["n", "mean", "P50", "P90", "P99", "waits"]
    for name in [*names, "not completed"] if broken else names:
        table.add_column(name, justify="right", no_wrap=name != "not completed")
    if summary["deadline_s"] is not None:
        table.add_column(f"within {summary['deadline_s']:g} s", justify="right")
    for cell in summary["cells"]:
        row = _row(cell, varied)
        if broken:
            row.append(_percent(cell["not_completed"]))
        if summary["deadline_s"] is not None:
            row.append(_percent(cell["in_time"]) if "in_time" in cell else "-")
        table.add_row(*row)
    console.print(table)
    for entry in summary["differences"]:
        low, high = entry["makespan_s"]["low"], entry["makespan_s"]["high"]
        where = "".join(f", {key} {value}" for key, value in entry["variant"].items())
        console.print(
            f"{entry['policy']} - {entry['reference']}{where}:"
            f" {entry['makespan_s']['estimate']:+.1f} s"
            f" ({_span(low, high)}; {100 * entry['relative']:+.1f} %), same draws"
        )


def _print_rest(console: Console, result: StudyResult) -> None:
    """Print lines, what has no plan, what collided, warnings, what is worth fixing, the folder."""
    summary = result.summary
    _print_lines(console, summary)
    for item in summary["refused"]:
        console.print(
            f"[yellow]no plan[/yellow]: {words(item['layout'])}:",
            Text(item["reason"]),
            soft_wrap=True,
        )
    for cell in summary["cells"]:
        if "collided" in cell:
            share = _percent(cell["collided"])
            console.print(f"{cell['policy']}: {collisions(cell)} ({share})")
    for warning in summary["warnings"]:
        console.print("[yellow]warning[/yellow]:", Text(warning), soft_wrap=True)
    _print_gains(console, result)
    console.print(f"{result.folder}")


def _print_lines(console: Console, summary: Mapping[str, Any]) -> None:
    """Print throughput, takt, lateness and who is busy, where several products are made."""
    head, rows = line_rows(summary)
    if not rows:
        return
    for names, lines in ((head, rows), busy_rows(summary)):
        table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
        for name in names:
            table.add_column(name, justify="left" if name == names[0] else "right")
        for line in lines:
            table.add_row(*line)
        console.print(table)


def _print_ranking(
    console: Console, summary: Mapping[str, Any], policies: Sequence[str]
) -> None:
    """Print the layouts in their order under the policy that coordinates best."""
    policy = shown_policy(policies)
    rows = ranking_rows(summary, policy)
    keys = [
        k for k in rows[0]["variant"] if len({str(r["variant"][k]) for r in rows}) > 1
    ]
    count = summary["cells"][rows[0]["cell"]]["replications"]
    table = Table(
        title=f"{summary['scenario']}: makespan in seconds of each layout, {policy},"
        f" {count} replications with the same draws",
        title_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    for name in ("rank", *keys, "mean", "P90", "behind the quickest"):
        table.add_column(name, overflow="fold")
    for row in rows:
        cell = summary["cells"][row["cell"]]
        values = (str(row["variant"][key]) for key in keys)
        doubt = "" if row["rank"] == 1 or told_apart(row) else ", not told apart"
        p90 = f"{cell['makespan_p90_s']['estimate']:.1f}"
        behind = behind_words(row) + doubt
        mean = _estimate(cell["makespan_s"])
        table.add_row(str(row["rank"]), *values, mean, p90, behind)
    console.print(table)
    if len(policies) > 1:
        console.print(f"other policies: {REPORT}", highlight=False)


def _print_gains(console: Console, result: StudyResult) -> None:
    """Print what is worth fixing most in the cell that coordinates best."""
    cell = shown_cell(result.summary, result.request.experiment.policies)
    gains = result.gains[cell]
    if not gains.gains:
        return
    table = Table(
        title=f"\nworth fixing ({cell_label(result.summary['cells'][cell])}): seconds by"
        f" which the work is done sooner, {gains.replications} replications executed again",
        title_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    table.add_column("what", overflow="fold")
    for name in (f"mean, {LESS}", f"{P90}, {LESS}", "mean, gone"):
        table.add_column(name, justify="right", max_width=14)
    for many, most in _TOP:
        for gain in gains.best(most, many=many):
            shown = (gain.shorter.mean, gain.shorter.p90, gain.gone.mean)
            table.add_row(gain.lever.name, *map(_gained, shown))
        table.add_section()
    console.print(table)


def _gained(interval: Interval) -> str:
    """Return seconds gained, with half the length of the interval where there is one."""
    half = interval.half_width
    if not isfinite(half):
        return f"{interval.estimate:.2f}"
    return f"{interval.estimate:.2f} ± {half:.2f}"


def _row(cell: Mapping[str, Any], varied: list[str]) -> list[str]:
    row = [cell["policy"], *(str(cell["variant"][key]) for key in varied)]
    row.append(str(cell["replications"]))
    row.append(_estimate(cell.get("makespan_s")))
    for key in ("makespan_p50_s", "makespan_p90_s", "makespan_p99_s"):
        row.append(f"{cell[key]['estimate']:.1f}" if key in cell else "-")
    waits = cell.get("wait_s")
    row.append("-" if waits is None else f"{sum(waits.values()):.1f}")
    return row


def _estimate(entry: Mapping[str, Any] | None) -> str:
    if entry is None:
        return "-"
    if entry["low"] is None:
        return f"{entry['estimate']:.1f}"
    half = 0.5 * (entry["high"] - entry["low"])
    return f"{entry['estimate']:.1f} ± {half:.1f}"


def _percent(entry: Mapping[str, Any]) -> str:
    low, high = 100 * entry["low"], 100 * entry["high"]
    return f"{100 * entry['estimate']:.1f} % ({low:.1f} to {high:.1f})"


def _span(low: float | None, high: float | None) -> str:
    return "no interval" if low is None else f"{low:+.1f} to {high:+.1f}"
