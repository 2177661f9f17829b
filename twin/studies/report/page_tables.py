"""Tables and lists of a study report: makespans, production lines, failures and cell layouts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.operations.replicated.operating import RUNGS
from twin.runs.policies import OPEN_LOOP
from twin.studies.folder import task_columns
from twin.studies.gains.candidates import task_names
from twin.studies.replications.block_results import TaskTally
from twin.studies.replications.statistics import Interval
from twin.studies.replications.workload import Workload
from twin.studies.report.estimates import format_estimate, format_in_line
from twin.studies.report.markup import (
    breakable,
    bullets,
    escape_text,
    table,
    text_table,
)
from twin.studies.study import StudyResult
from twin.studies.summary import CellSummary, StudySummary
from twin.throughput.states import STATES
from twin.throughput.throughput import OF_VARIANT

OPERATED = (
    "Where a skill failed for good, or a robot was out, the remaining work was replanned. Makespans are of"
    " replications in which all steps were done. Regret is by how much they are longer than those of a plan that"
    " knew from the beginning what would be lost, in which attempts fail and never for good. What follows further"
    " down, such as what is worth fixing, is of the first plan, and of replications in which nothing was replanned."
)
_SHARE = "{:.1f} %"

HEAD = (
    *("products an hour", "takt [s]", "takt P99 [s]", "cycle time [s]"),
    *("cycle time P99 [s]", "work in progress"),
)
LATE = "late products"


def critical_tasks_table(
    load: Workload, tally: TaskTally, label: str, most: int
) -> str:
    """Return the tasks that were critical most often, by name."""
    columns, names = task_columns(load, tally), task_names(load.tpg.tasks)
    share, slack_s = columns["criticality"], columns["slack_mean_s"]
    time_s = columns["end_p50_s"] - columns["start_p50_s"]
    order = np.lexsort((-time_s, -share))[: np.count_nonzero(share > 0)]
    caption = f"{label}: tasks that were on the critical path most often"
    if len(order) > most:
        caption += f", {most} of {len(order)}; all are in tasks.parquet"
    rows = [
        [
            str(rank),
            escape_text(names[columns["task"][k]]),
            f"{100 * share[k]:.0f} %",
            f"{slack_s[k]:.1f}",
            f"{time_s[k]:.1f}",
        ]
        for rank, k in enumerate(order[:most].tolist(), start=1)
    ]
    head = ["", "task", "on the critical path", "mean slack [s]", "median time [s]"]
    return table(caption, head, rows, "named")


def busy_rows(summary: StudySummary) -> tuple[list[str], list[list[str]]]:
    """Return head and rows of the table of all cells with completed replications."""
    cells = [cell for cell in summary.cells if cell.utilisation]
    names = list(dict.fromkeys(name for cell in cells for name in cell.utilisation))
    rows = [
        [
            cell.label,
            *(
                f"{100 * cell.utilisation[name]:.1f} %"
                if name in cell.utilisation
                else "-"
                for name in names
            ),
        ]
        for cell in cells
    ]
    return ["busy", *names], rows


def line_rows(summary: StudySummary) -> tuple[list[str], list[list[str]]]:
    """Return the head and the rows of the table of all cells that make several products."""
    lines = [(cell.label, cell.line) for cell in summary.cells if cell.line]
    due = any(line.due for _, line in lines)
    rows = []
    for label, line in lines:
        row = [
            label,
            _mean(line.throughput_per_h, 1),
            _mean(line.takt_s),
            _p99(line.takt_quantiles_s),
            _mean(line.cycle_time_s),
            _p99(line.cycle_time_quantiles_s),
            _mean(line.work_in_progress),
        ]
        if due:
            late = line.due and line.due.late
            row.append(f"{100 * late.estimate:.1f} %" if late else "-")
        rows.append(row)
    return ["policy", *HEAD, *([LATE] if due else [])], rows


def lines_table(summary: StudySummary) -> str:
    """Return the table for the report, nothing where nothing is made several times."""
    words = ""
    for line in (cell.line for cell in summary.cells if cell.line):
        words = f"{line.products} products"
        if line.start_up:
            words += f"; takt and work in progress without the first {line.start_up}"
        break
    return text_table(words, line_rows(summary))


def variant_rows(summary: StudySummary) -> tuple[list[str], list[list[str]]]:
    """Return the head and the rows of the table of variants of products."""
    rows = []
    for cell in summary.cells:
        for name, own in cell.line.variants.items() if cell.line else ():
            *numbers, in_time, lateness, first = (own[key] for key in OF_VARIANT)
            row = [cell.label, name, *(_mean(own) for own in numbers)]
            rows.append([*row, _percent(in_time), _mean(lateness), _percent(first)])
    head = ["policy", "variant", "an hour", "takt [s]", "cycle time [s]"]
    head += ["work in progress", "in time", "lateness [s]", "first pass"]
    return head, rows


def worker_rows(summary: StudySummary) -> tuple[list[str], list[list[str]]]:
    """Return the head and the rows of the table of time by state and effectiveness."""
    workers = [
        (cell.label, name, own)
        for cell in summary.cells
        if cell.line
        for name, own in cell.line.workers.items()
    ]
    factors = ["availability", "performance", "quality", "oee"]
    states = [s for s in STATES if any(s in own for *_, own in workers)]
    columns = (*states, *factors)
    rows = [
        [*names, *(_percent(own.get(c)) for c in columns)] for *names, own in workers
    ]
    return ["policy", "", *states, *factors[:3], "OEE"], rows


def window_rows(summary: StudySummary) -> tuple[list[str], list[list[str]]]:
    """Return the head and the rows of the table of all windows of time."""
    head = ["policy", "window", "within [s]", "passes [s]", "P95 [s]", "broken"]
    rows = []
    for cell in summary.cells:
        for own in cell.windows.windows if cell.windows else ():
            within = "-" if own.within_s is None else f"{own.within_s:g}"
            row = [cell.label, own.window, within]
            row += [f"{own.passed_s.estimate:.2f}", f"{own.passed_p95_s:.2f}"]
            row.append(
                "-" if own.broken is None else format_in_line(own.broken, _SHARE, 100.0)
            )
            free = own.broken_free
            row.append("-" if free is None else format_in_line(free, _SHARE, 100.0))
            rows.append(row)
    return [*head, "not held back"], rows


def holding_texts(summary: StudySummary) -> list[str]:
    """Return sentences on the cost of holding back for time windows."""
    return [
        f"{cell.label}: holding back with {cell.windows.hold:g} makes the makespan longer by"
        f" {format_in_line(cell.windows.holding_s, '{:.2f} s')}, replication by replication"
        for cell in summary.cells
        if cell.windows and cell.windows.holding_s
    ]


def operated_rows(summary: StudySummary) -> tuple[list[str], list[list[str]]]:
    """Return head and rows of the table of failure costs, one column per cell."""
    cells = [(cell.label, cell.operated) for cell in summary.cells if cell.operated]
    shown = {
        "completed": [format_in_line(own.completed, _SHARE, 100.0) for _, own in cells],
        "steps given up": [
            format_in_line(own.gave_up, _SHARE, 100.0) for _, own in cells
        ],
        "new plans": [_mean(own.versions) for _, own in cells],
        **{
            rung.replace("_", " "): [_mean(own.recoveries[rung]) for _, own in cells]
            for rung in RUNGS
        },
        "regret [s]": [_seconds(own.regret_s) for _, own in cells],
        "regret, new plans only [s]": [
            _seconds(own.regret_replanned_s) for _, own in cells
        ],
    }
    rows = [[name, *values] for name, values in shown.items() if values]
    return ["failures, a replication", *(label for label, _ in cells)], rows


def prevented_rows(summary: StudySummary) -> tuple[list[str], list[list[str]]]:
    """Return head and rows of the table of failure preventions, the best first."""
    head = ["worth preventing", "completed then", "more", "sooner by [s]"]
    rows = []
    for cell in summary.cells:
        for own in cell.operated.prevented if cell.operated else ():
            name = own.name if len(summary.cells) == 1 else f"{own.name}; {cell.label}"
            share = format_in_line(own.completed, _SHARE, 100.0)
            more = f"{100 * own.completed_more:+.1f} %"
            rows.append([name, share, more, _seconds(own.sooner_s)])
    return head, rows


def operated_tables(summary: StudySummary) -> str:
    """Return both tables and the abandoned steps; empty without replanning."""
    out = text_table("what came of failures for good, means", operated_rows(summary))
    texts = [
        f"{cell.label}: step {step} in {count} of {cell.replications} replications"
        for cell in summary.cells
        for step, count in (cell.operated.given_up if cell.operated else {}).items()
    ]
    words = "which failure is worth preventing first: the same draws without it"
    out += text_table(words, prevented_rows(summary), "named")
    return out + bullets("Steps that were given up", texts)


def _percent(found: Interval | None) -> str:
    return "-" if found is None else format_in_line(found, _SHARE, 100.0)


def _seconds(found: Interval | None) -> str:
    return "-" if found is None else format_in_line(found, "{:.2f}")


def lateness_list(summary: StudySummary) -> str:
    """Return sentences on the lateness of products; empty without due times."""
    texts = []
    for cell in summary.cells:
        due = cell.line and cell.line.due
        if due and due.late and due.lateness_s:
            worst = due.lateness_quantiles_s["p99"]
            texts.append(
                f"{cell.label}: {_percent(due.service_level)} of what is ordered is complete when it is due; a product is late with probability"
                f" {due.late.estimate:.3f}, any of them in"
                f" {100 * due.any_late.estimate:.1f} % of the replications; mean lateness"
                f" {due.lateness_s.estimate:.1f} s, P99 {worst:.1f} s"
            )
    return bullets("Lateness", texts)


def ranking_table(summary: StudySummary, policy: str) -> str:
    """Return the layouts under a policy in their order, as a table."""
    rows = summary.ranked(policy)
    keys = list(rows[0].variant)
    cells = [
        [
            str(row.rank),
            *(breakable(row.variant[key]) for key in keys),
            f"{row.mean_s:.1f}",
            escape_text(row.behind),
            "" if row.rank == 1 or row.significantly_slower else "not distinguished",
        ]
        for row in rows
    ]
    share = f"{100 * summary.confidence:g} %"
    caption = (
        f"Layouts under {policy} by mean makespan in seconds; behind the quickest,"
        f" replication by replication, with intervals that hold together with {share}"
    )
    return table(caption, ["rank", *keys, "mean", "behind", ""], cells)


def refused_table(summary: StudySummary) -> str:
    """Return the layouts that have no plan, with the reason; nothing where all have one."""
    keys = list(summary.refused[0].layout) if summary.refused else []
    rows = [
        [*(breakable(item.layout[key]) for key in keys), escape_text(item.reason)]
        for item in summary.refused
    ]
    return table("Layouts without a plan", [*keys, "reason"], rows, "named")


def replication_sentence(result: StudyResult) -> str:
    """Return a sentence on the number of replications."""
    experiment, summary = result.request.experiment, result.summary
    counts = sorted({cell.replications for cell in summary.cells})
    many = " to ".join(str(count) for count in dict.fromkeys((counts[0], counts[-1])))
    words = (
        f"{many} replications of {len(experiment.policies)} policies"
        f" with the same draws, seed {result.request.scenario.seed}."
    )
    if experiment.replications is None:
        words += (
            f" Sampling went on until the {100 * summary.confidence:g} % interval of"
            f" every mean was within {100 * experiment.precision.relative_half_width:g} %,"
            f" or {experiment.precision.most} replications were done."
        )
    return words


def makespans_table(
    summary: StudySummary, cells: Sequence[CellSummary] | None = None
) -> str:
    """Return the makespans of some cells, by default all, as a table."""
    keys, deadline = list(summary.cells[0].variant), summary.deadline_s
    head = ["policy", *keys, "n", "mean", "P50", "P90", "P95", "P99"]
    head += ["not completed"] + ([f"within {deadline:g} s"] if deadline else [])
    rows = []
    for cell in summary.cells if cells is None else cells:
        row = [
            escape_text(cell.policy),
            *(breakable(cell.variant[key]) for key in keys),
        ]
        row.append(str(cell.replications))
        row += map(
            format_estimate,
            (
                cell.makespan_s,
                cell.makespan_p50_s,
                cell.makespan_p90_s,
                cell.makespan_p95_s,
                cell.makespan_p99_s,
            ),
        )
        row.append(format_estimate(cell.not_completed, percent=True))
        if deadline:
            row.append(format_estimate(cell.in_time, percent=True))
        rows.append(row)
    share = f"{100 * summary.confidence:g} %"
    return table(f"Makespan in seconds, with {share} intervals", head, rows)


def difference_list(summary: StudySummary) -> str:
    """Return a list of the policies against the first one."""
    texts = []
    for entry in summary.differences:
        where = "".join(f", {key} = {value}" for key, value in entry.variant.items())
        texts.append(
            f"{entry.policy} against {entry.reference}{where}:"
            f" {format_in_line(entry.makespan_s, '{:+.1f} s')}, {100 * entry.relative:+.1f} %"
        )
    return bullets("Differences, replication by replication", texts)


def collision_lists(summary: StudySummary) -> str:
    """Return lists of collisions in open-loop cells and with base errors, if studied."""
    titles = {True: "When no robot waits for another", False: "When bases are off"}
    out = ""
    for is_open, title in titles.items():
        texts = [
            f"{cell.label}: {cell.collisions}, {format_in_line(cell.collided, '{:.0f} %', 100.0)}"
            for cell in summary.cells
            if cell.collided is not None and (cell.policy == OPEN_LOOP) == is_open
        ]
        out += bullets(title, texts)
    return out


def _mean(found: Interval | None, digits: int = 2) -> str:
    return "-" if found is None else f"{found.estimate:.{digits}f}"


def _p99(quantiles: dict[str, float]) -> str:
    return f"{quantiles['p99']:.2f}" if quantiles else "-"
