"""Throughput, takt and lateness of lines, as rows of tables and as a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from twin.drawing.markup import bullets, table, text
from twin.durations import NANOSECONDS
from twin.host.pictures import INK
from twin.run.throughput import takts_s
from twin.study.line import Due
from twin.study.replications.block_results import ProductTimes
from twin.study.report.layout import one_chart
from twin.study.tables import cell_label

HEAD = (
    *("products an hour", "takt [s]", "takt P99 [s]", "cycle time [s]"),
    *("cycle time P99 [s]", "work in progress"),
)
LATE = "late products"


def line_rows(summary: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Return the head and the rows of the table of all cells that make several products."""
    cells = [cell for cell in summary["cells"] if "line" in cell]
    due = any(cell["line"]["due"] for cell in cells)
    rows = []
    for cell in cells:
        line = cell["line"]
        row = [
            cell_label(cell),
            _mean(line["throughput_per_h"], 1),
            _mean(line["takt_s"]),
            _quantile(line["takt_quantiles_s"]),
            _mean(line["cycle_time_s"]),
            _quantile(line["cycle_time_quantiles_s"]),
            _mean(line["work_in_progress"]),
        ]
        if due:
            late = line["due"]
            share = "-" if not late else f"{100 * late['late']['estimate']:.1f} %"
            row.append(share)
        rows.append(row)
    return ["policy", *HEAD, *([LATE] if due else [])], rows


def lines_table(summary: Mapping[str, Any]) -> str:
    """Return the table for the report, nothing where nothing is made several times."""
    head, rows = line_rows(summary)
    if not rows:
        return ""
    shown = [[text(value) for value in row] for row in rows]
    line = next(cell["line"] for cell in summary["cells"] if "line" in cell)
    words = f"{line['products']} products"
    if line["start_up"]:
        words += f"; takt and work in progress without the first {line['start_up']}"
    return table(words, head, shown)


def lateness_list(summary: Mapping[str, Any]) -> str:
    """Return in words how late products are, nothing where none is due."""
    texts = []
    for cell in summary["cells"]:
        late = cell.get("line", {}).get("due")
        if late:
            anyone = 100 * late["any_late"]["estimate"]
            worst = late["lateness_quantiles_s"]["p99"]
            texts.append(
                f"{cell_label(cell)}: a product is late with probability"
                f" {late['late']['estimate']:.3f}, any of them in {anyone:.1f} % of the"
                f" replications; mean lateness {late['lateness_s']['estimate']:.1f} s,"
                f" P99 {worst:.1f} s"
            )
    return bullets("Lateness", texts)


def draw_line(times: ProductTimes, due: Due) -> Figure:
    """Draw when products are complete, against when they are due, and the takt.

    Args:
        times: of one cell.
        due: when they are due, and which do not count.
    """
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


def _mean(interval: Mapping[str, Any] | None, digits: int = 2) -> str:
    return "-" if interval is None else f"{interval['estimate']:.{digits}f}"


def _quantile(values: Mapping[str, float]) -> str:
    return f"{values['p99']:.2f}" if values else "-"


def has_lines(cells: Sequence[Mapping[str, Any]]) -> bool:
    """Tell whether any cell makes several products."""
    return any("line" in cell for cell in cells)
