"""What is worth fixing, as a table of the report and in words.

How busy robots and machines are, as rows of tables.

Makespans of all policies and variants, as tables and lists of the report.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from twin.drawing.markup import (
    breakable,
    bullets,
    estimate,
    paragraph,
    span,
    table,
    text,
)
from twin.study.gains.gains import QUANTILE, SHORTER, CellGains, Gain
from twin.study.study import StudyResult
from twin.study.tables import cell_label, collisions

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
    "Seconds by which the work would be done sooner, the last part in its place, if one thing took a"
    " fifth less time, or none, and all else stayed as it was drawn: the same replications were"
    " executed again with that one thing changed. What robots do after their last work, such as"
    " going HOME, is part of the makespan and of nothing here. These are gains of the model, as good as its times are. Whether something can be"
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
                f"{row['slack_mean_s']:.1f}",
                f"{row['time_p50_s']:.1f}",
            ]
            for rank, row in enumerate(shown, start=1)
        ],
        "named",
    )


def busy_rows(summary: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Return the head and the rows of the table of all cells in which something was complete."""
    cells = [cell for cell in summary["cells"] if "utilisation" in cell]
    names = list(dict.fromkeys(name for cell in cells for name in cell["utilisation"]))
    rows = [
        [cell_label(cell), *(_share(cell["utilisation"].get(name)) for name in names)]
        for cell in cells
    ]
    return ["busy", *names], rows


def busy_table(summary: Mapping[str, Any]) -> str:
    """Return the table for the report, nothing where no replication was complete."""
    head, rows = busy_rows(summary)
    shown = [[text(value) for value in row] for row in rows]
    words = "share of the time at work, standstills in it included"
    return table(words, head, shown)


def _share(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.1f} %"


def lead(result: StudyResult) -> str:
    """Return in words how much was replicated."""
    experiment, summary = result.request.experiment, result.summary
    counts = sorted({cell["replications"] for cell in summary["cells"]})
    many = " to ".join(str(count) for count in dict.fromkeys((counts[0], counts[-1])))
    words = (
        f"{many} replications of {len(experiment.policies)} policies"
        f" with the same draws, seed {result.request.scenario.seed}."
    )
    if experiment.replications is None:
        words += (
            f" Sampling went on until the {100 * summary['confidence']:g} % interval of"
            f" every mean was within {100 * experiment.precision.relative_half_width:g} %,"
            f" or {experiment.precision.most} replications were done."
        )
    return words


def makespans_table(
    summary: Mapping[str, Any], cells: Sequence[Mapping[str, Any]] | None = None
) -> str:
    """Return the makespans of some cells, by default all, as a table."""
    varied = list(summary["cells"][0]["variant"])
    deadline = summary["deadline_s"]
    head = ["policy", *varied, "n", "mean", "P50", "P90", "P95", "P99"]
    head += ["not completed"] + ([f"within {deadline:g} s"] if deadline else [])
    rows = []
    for cell in summary["cells"] if cells is None else cells:
        row = [
            text(cell["policy"]),
            *(breakable(cell["variant"][key]) for key in varied),
        ]
        row.append(str(cell["replications"]))
        for key in ("makespan_s", *(f"makespan_p{p}_s" for p in (50, 90, 95, 99))):
            row.append(estimate(cell.get(key)))
        row.append(estimate(cell["not_completed"], factor=100.0, unit=" %"))
        if deadline:
            row.append(estimate(cell.get("in_time"), factor=100.0, unit=" %"))
        rows.append(row)
    share = f"{100 * summary['confidence']:g} %"
    return table(f"Makespan in seconds, with {share} intervals", head, rows)


def differences(summary: Mapping[str, Any]) -> str:
    """Return a list of the policies against the first one."""
    texts = []
    for entry in summary["differences"]:
        difference = span(entry["makespan_s"], "{:+.1f} s")
        where = "".join(f", {key} = {value}" for key, value in entry["variant"].items())
        texts.append(
            f"{entry['policy']} against {entry['reference']}{where}: {difference},"
            f" {100 * entry['relative']:+.1f} %"
        )
    return bullets("Differences, replication by replication", texts)


def collided(summary: Mapping[str, Any]) -> str:
    """Return a list of what happens when nobody waits for anybody; nothing if not studied."""
    texts = []
    for cell in summary["cells"]:
        if "collided" in cell:
            share = span(cell["collided"], "{:.0f} %", 100.0)
            texts.append(f"{cell_label(cell)}: {collisions(cell)}, {share}")
    return bullets("When nobody waits for anybody", texts)
