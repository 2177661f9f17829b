"""What is worth fixing, as a table of the report and in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from twin.drawing.markup import estimate, paragraph, table, text
from twin.study.gains.gains import QUANTILE, SHORTER, CellGains, Gain

KINDS = {
    "task": "task",
    "skill": "skill",
    "robot": "robot",
    "wait": "wait",
    "stall": "standstill",
    "message": "messages",
}

_LEAST_S = 0.005
"""Gains that are worth a line [s]."""

LESS = f"{100 * SHORTER:.0f} % shorter"
P90 = f"P{100 * QUANTILE:.0f}"

HONEST = (
    "Seconds that the makespan would fall by if one thing took a fifth less time, or none, and all"
    " else stayed as it was drawn: the same replications were executed again with that one thing"
    " changed. These are gains of the model, as good as its times are. Whether something can be"
    " made shorter, and what that costs, it does not know; gains of several do not add up, and"
    " robots are never assigned or planned anew. A wait that is gone is a robot that does not"
    " wait, whatever stands in its way: more than any better plan can do."
)


def gains_tables(cell: CellGains, label: str, *, confidence: float, most: int) -> str:
    """Return the greatest gains of a cell: one thing each, then many at once.

    Args:
        cell: its gains.
        label: of the cell.
        confidence: of the intervals.
        most: rows of each table.
    """
    if cell.replications == 0:
        return paragraph(
            f"{label}: nothing was tried. No replication was completed, or the event engine would"
            " take longer for it than for the study; more replications give it more time."
        )
    share = f"{100 * confidence:g} %"
    made = f"seconds gained with {share} intervals, {cell.replications} replications"
    tables = []
    for what, many in (("one thing", False), ("many at once", True)):
        found = cell.best(most, many=many)
        shown = [gain for gain in found if gain.gone.mean.estimate >= _LEAST_S]
        tables.append(_table(f"{label}: {what}, {made}", shown))
    if not any(tables):
        return paragraph(f"{label}: nothing that was tried gains anything.")
    rest = len(cell.gains) - sum(len(cell.best(most, many=m)) for m in (False, True))
    return "".join(tables) + (
        paragraph(f"{rest} more are in gains.csv.", "note") if rest else ""
    )


def _table(caption: str, gains: Sequence[Gain]) -> str:
    """Return gains as a table, nothing where there are none."""
    head = ["", "", "what", f"mean, {LESS}", f"{P90}, {LESS}", "mean, gone"]
    longest = max([gain.shorter.mean.estimate for gain in gains], default=0.0)
    rows = []
    for rank, gain in enumerate(gains, start=1):
        width = 100.0 * max(gain.shorter.mean.estimate, 0.0) / max(longest, 1e-12)
        bar = f'<div class="bar" style="width:{width:.0f}%"></div>'
        kind = f'<span class="kind">{KINDS[gain.lever.kind]}</span>'
        row = [str(rank), kind, text(gain.lever.name) + bar]
        for saving in (gain.shorter, gain.gone):
            row += [estimate(one.content()) for one in (saving.mean, saving.p90)]
        rows.append(row)
    return table(caption, [*head, f"{P90}, gone"], rows, "gains")


def critical_tasks_table(rows: list[Mapping[str, Any]], label: str, most: int) -> str:
    """Return the tasks that were critical most often, by name.

    Args:
        rows: of the table of tasks, with the ``name`` of each.
        label: of the cell.
        most: rows that are shown.
    """
    ordered = sorted(rows, key=lambda row: (-row["criticality"], -row["time_p50_s"]))
    shown = [row for row in ordered if row["criticality"] > 0][:most]
    critical = sum(row["criticality"] > 0 for row in rows)
    caption = f"{label}: tasks that were on the critical path most often"
    if critical > len(shown):
        caption += f", {len(shown)} of {critical}; all are in tasks.parquet"
    return table(
        caption,
        ["", "task", "on the critical path", "mean slack [s]", "median time [s]"],
        [
            [
                str(rank),
                text(row["name"]),
                f"{100 * row['criticality']:.0f} %",
                "-" if row["slack_mean_s"] is None else f"{row['slack_mean_s']:.1f}",
                f"{row['time_p50_s']:.1f}",
            ]
            for rank, row in enumerate(shown, start=1)
        ],
        "named",
    )
