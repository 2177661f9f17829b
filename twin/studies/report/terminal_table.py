"""Table of the results of a study, printed in the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

from rich.box import SIMPLE_HEAD
from rich.console import Console, JustifyMethod
from rich.table import Table
from rich.text import Text

from twin.runs.policies import preferred_policy
from twin.studies.folder import REPORT
from twin.studies.plans import words
from twin.studies.replications.statistics import Interval
from twin.studies.report.page_tables import (
    busy_rows,
    holding_texts,
    line_rows,
    operated_rows,
    prevented_rows,
    window_rows,
)
from twin.studies.report.sensitivity_tables import LESS, P90
from twin.studies.study import StudyResult
from twin.studies.summary import CellSummary, StudySummary, shown_cell

_SHOWN = (50, 90, 99)
"""Percentiles of the makespan in the table."""

_TOP = ((True, 2), (False, 3))
"""Rows of gains: joint interventions, and single ones."""


def print_study(result: StudyResult) -> None:
    """Print makespans with their intervals, differences between policies, and the folder."""
    console = Console(highlight=False)
    if result.summary.ranking:
        _print_ranking(console, result.summary, result.request.experiment.policies)
    else:
        _print_makespans(console, result.summary)
    _print_rest(console, result)


def _table(title: str | None = None) -> Table:
    """Return a table without columns yet."""
    return Table(
        title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0)
    )


def _print_makespans(console: Console, summary: StudySummary) -> None:
    """Print the makespans of all policies and variants, and how policies differ."""
    share = f"{100 * summary.confidence:g} %"
    table = _table(f"{summary.scenario}: makespan in seconds, {share} intervals")
    varied = list(summary.cells[0].variant)
    for name in ("policy", *varied):
        table.add_column(name, overflow="fold", min_width=min(len(name), 12))
    broken = any(cell.not_completed.estimate for cell in summary.cells)
    names = ["n", "mean", *(f"P{p}" for p in _SHOWN), "waits"]
    for name in [*names, "not completed"] if broken else names:
        table.add_column(name, justify="right", no_wrap=name != "not completed")
    if summary.deadline_s is not None:
        table.add_column(f"within {summary.deadline_s:g} s", justify="right")
    for cell in summary.cells:
        row = _row(cell, varied)
        if broken:
            row.append(_percent(cell.not_completed))
        if summary.deadline_s is not None:
            row.append("-" if cell.in_time is None else _percent(cell.in_time))
        table.add_row(*row)
    console.print(table)
    _print_open(console, summary.cells)
    for entry in summary.differences:
        where = "".join(f", {key} {value}" for key, value in entry.variant.items())
        span = entry.makespan_s.bounds("{:+.1f}".format) or "no interval"
        console.print(
            f"{entry.policy} - {entry.reference}{where}:"
            f" {entry.makespan_s.estimate:+.1f} s"
            f" ({span}; {100 * entry.relative:+.1f} %), same draws"
        )


def _print_rest(console: Console, result: StudyResult) -> None:
    """Print lines, infeasible layouts, collisions, warnings, gains, the folder."""
    summary = result.summary
    _print_lines(console, summary)
    for item in summary.refused:
        console.print(
            f"[yellow]no plan[/yellow]: {words(item.layout)}:",
            Text(item.reason),
            soft_wrap=True,
        )
    for cell in summary.cells:
        if cell.collided is not None:
            share = _percent(cell.collided)
            console.print(f"{cell.policy}: {cell.collisions} ({share})")
    if summary.closed_loop:
        console.print("replanned after failures, as by twin operate")
    for warning in summary.warnings:
        console.print("[yellow]warning[/yellow]:", Text(warning), soft_wrap=True)
    _print_gains(console, result)
    console.print(f"{result.folder}")


def _print_lines(console: Console, summary: StudySummary) -> None:
    """Print throughput, takt, lateness and utilization of lines; and windows."""
    tables = [line_rows(summary)]
    if tables[0][1]:
        tables.append(busy_rows(summary))
    tables += [operated_rows(summary), prevented_rows(summary)]
    for names, lines in (*tables, window_rows(summary)):
        if not lines:
            continue
        table = _table()
        for name in names:
            side: JustifyMethod = "left" if name == names[0] else "right"
            table.add_column(Text(name), justify=side)
        for line in lines:
            table.add_row(*map(Text, line))
        console.print(table)
    for text in holding_texts(summary):
        console.print(text, soft_wrap=True)


def _print_ranking(
    console: Console, summary: StudySummary, policies: Sequence[str]
) -> None:
    """Print the layouts in their order under the policy that coordinates best."""
    policy = preferred_policy(policies)
    rows = summary.ranked(policy)
    keys = [
        k for k in rows[0].variant if len({str(row.variant[k]) for row in rows}) > 1
    ]
    count = summary.cells[rows[0].cell].replications
    table = _table(
        f"{summary.scenario}: makespan in seconds of each layout, {policy},"
        f" {count} replications with the same draws"
    )
    for name in ("rank", *keys, "mean", "P90", "behind the quickest"):
        table.add_column(name, overflow="fold")
    for row in rows:
        cell = summary.cells[row.cell]
        values = (str(row.variant[key]) for key in keys)
        doubt = (
            "" if row.rank == 1 or row.significantly_slower else ", not distinguished"
        )
        mean, p90 = (
            _estimate(cell.makespan_s),
            _quantile(cell.makespan_p90_s),
        )
        table.add_row(str(row.rank), *values, mean, p90, row.behind + doubt)
    console.print(table)
    _print_open(console, [summary.cells[row.cell] for row in rows], (90,))
    if len(policies) > 1:
        console.print(f"other policies: {REPORT}", highlight=False)


def _print_gains(console: Console, result: StudyResult) -> None:
    """Print the greatest gains in the cell that coordinates best."""
    cell = shown_cell(result.summary, result.request.experiment.policies)
    gains = result.gains[cell]
    if not gains.gains:
        return
    table = _table(
        f"\nworth fixing ({result.summary.cells[cell].label}): seconds by"
        f" which the work is done sooner, {gains.replications} replications executed again"
    )
    table.add_column("what", overflow="fold")
    for name in (f"mean, {LESS}", f"{P90}, {LESS}", "mean, gone"):
        table.add_column(name, justify="right", max_width=14)
    for many, most in _TOP:
        for gain in gains.best(most, many=many):
            shown = (gain.shorter.mean_s, gain.shorter.p90_s, gain.gone.mean_s)
            table.add_row(gain.intervention.name, *(_estimate(one, 2) for one in shown))
        table.add_section()
    console.print(table)


def _row(cell: CellSummary, varied: list[str]) -> list[str]:
    row = [cell.policy, *(str(cell.variant[key]) for key in varied)]
    row += [str(cell.replications), _estimate(cell.makespan_s)]
    for p in _SHOWN:
        row.append(_quantile(getattr(cell, f"makespan_p{p}_s")))
    return [*row, f"{sum(cell.wait_s.values()):.1f}" if cell.wait_s else "-"]


def _estimate(found: Interval | None, digits: int = 1, *, bare: bool = False) -> str:
    """Return an estimate, with its distance to the farther bound unless it is to be bare."""
    if found is None:
        return "-"
    half = found.half_width
    text = "" if bare or not isfinite(half) else f" ± {half:.{digits}f}"
    return f"{found.estimate:.{digits}f}{text}"


def _quantile(found: Interval | None) -> str:
    """Return the estimate of a quantile, or its lower bound where there is no upper one."""
    if found is None or isfinite(found.high):
        return _estimate(found, bare=True)
    return f"≥ {found.low:.1f}" if isfinite(found.low) else "open"


def _print_open(
    console: Console, cells: Sequence[CellSummary], shown: Sequence[int] = _SHOWN
) -> None:
    """Print how many replications are needed where quantiles have no limits."""
    found = ((p, getattr(cell, f"makespan_p{p}_s")) for p in shown for cell in cells)
    needed = {p: one.replications_needed for p, one in found if one is not None}
    text = ", ".join(f"{count} for P{p}" for p, count in needed.items() if count)
    if text:
        words = "≥: from so few replications there is no upper limit; needed are"
        console.print(f"{words} {text}", soft_wrap=True)


def _percent(found: Interval) -> str:
    low, high = 100 * found.low, 100 * found.high
    return f"{100 * found.estimate:.1f} % ({low:.1f} to {high:.1f})"
