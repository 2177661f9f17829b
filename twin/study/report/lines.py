"""Throughput, takt and lateness of lines, as rows of tables and as a picture."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from twin.drawing.markup import bullets, table, text
from twin.durations.model import NANOSECONDS
from twin.host.pictures import INK
from twin.run.throughput import takts_s
from twin.study.line import Due
from twin.study.replications.block_results import ProductTimes
from twin.study.replications.statistics import Interval
from twin.study.report.layout import one_chart
from twin.study.summary import StudySummary

HEAD = (
    *("products an hour", "takt [s]", "takt P99 [s]", "cycle time [s]"),
    *("cycle time P99 [s]", "work in progress"),
)
LATE = "late products"


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
    head, rows = line_rows(summary)
    words = ""
    for line in (cell.line for cell in summary.cells if cell.line):
        words = f"{line.products} products"
        if line.start_up:
            words += f"; takt and work in progress without the first {line.start_up}"
        break
    return table(words, head, [map(text, row) for row in rows])


def lateness_list(summary: StudySummary) -> str:
    """Return in words how late products are, nothing where none is due."""
    texts = []
    for cell in summary.cells:
        due = cell.line and cell.line.due
        if due and due.late and due.lateness_s:
            worst = due.lateness_quantiles_s["p99"]
            texts.append(
                f"{cell.label}: a product is late with probability"
                f" {due.late.estimate:.3f}, any of them in"
                f" {100 * due.any_late.estimate:.1f} % of the replications; mean lateness"
                f" {due.lateness_s.estimate:.1f} s, P99 {worst:.1f} s"
            )
    return bullets("Lateness", texts)


def draw_line(times: ProductTimes, due: Due) -> Figure:
    """Draw when products are complete, against when they are due, and the takt."""
    figure, axes = one_chart(4.2)
    end = times.product_end_ns / NANOSECONDS
    number = np.arange(1, len(end) + 1)
    takt = takts_s(times.product_end_ns, due[1])
    pace = float(takt.mean()) if takt.size else 0.0
    # What every product would take at the mean pace is left out: what remains can be seen.
    level = (number - 1) * pace
    low, middle, high = np.quantile(end, (0.05, 0.5, 0.95), axis=1)
    axes.fill_between(
        number, low - level, high - level, color="#c6d8ea", label="P5 to P95"
    )
    axes.plot(number, middle - level, color="#1f5f9e", lw=1.8, label="complete, median")
    if due[0]:
        axes.plot(
            number,
            np.asarray(due[0]) - level,
            color="#b8433a",
            lw=1.4,
            ls="--",
            label="due",
        )
    axes.set_xlabel("product", color=INK)
    axes.set_ylabel(f"time [s], less {pace:.2f} s a product", color=INK)
    axes.legend(frameon=False, labelcolor=INK, fontsize=9)
    return figure


def _mean(found: Interval | None, digits: int = 2) -> str:
    return "-" if found is None else f"{found.estimate:.{digits}f}"


def _p99(quantiles: dict[str, float]) -> str:
    return f"{quantiles['p99']:.2f}" if quantiles else "-"
