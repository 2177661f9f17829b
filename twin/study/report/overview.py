"""Makespans of all policies and variants, as tables and lists of the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from twin.drawing.markup import breakable, bullets, estimate, span, table, text
from twin.study.study import StudyResult
from twin.study.summary import cell_label, collisions


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
