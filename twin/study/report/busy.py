"""How busy robots and machines are, as rows of tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twin.drawing.markup import table, text
from twin.study.summary import cell_label


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
