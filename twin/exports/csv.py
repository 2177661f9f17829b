"""CSV (RFC 4180): one file a table, a header line, SI units, empty fields where there is nothing."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO

import pyarrow as pa
import pyarrow.csv

from twin.exports.exporter import ExportOptions
from twin.exports.recorded_run import RecordedRun
from twin.exports.tables import run_tables

_PARTS = {"xyz": ("x", "y", "z"), "quat_wxyz": ("qw", "qx", "qy", "qz")}


class CsvExporter:
    """Writes ``events.csv``, ``trajectory.csv`` and ``objects.csv``."""

    def export(self, run: RecordedRun, options: ExportOptions) -> Mapping[str, bytes]:
        """Return the files; vectors become a column a component."""
        del options
        return {f"{name}.csv": _csv(table) for name, table in run_tables(run).items()}


def _csv(table: pa.Table) -> bytes:
    columns = {}
    for name in table.column_names:
        column = table.column(name).combine_chunks()
        if name in _PARTS:
            size = len(_PARTS[name])
            values = column.flatten()
            for k, part in enumerate(_PARTS[name]):
                columns[part] = values.take(pa.array(range(k, len(values), size)))
        elif pa.types.is_dictionary(column.type):
            columns[name] = column.cast(pa.string())
        else:
            columns[name] = column
    buffer = BytesIO()
    pa.csv.write_csv(pa.table(columns), buffer)
    return buffer.getvalue()
