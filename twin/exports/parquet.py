"""Parquet: the same tables as CSV, with types, zstd compressed."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO

import pyarrow.parquet as pq

from twin.exports.exporter import ExportOptions
from twin.exports.recorded_run import RecordedRun
from twin.exports.tables import run_tables


class ParquetExporter:
    """Writes ``events.parquet``, ``trajectory.parquet`` and ``objects.parquet``."""

    def export(self, run: RecordedRun, options: ExportOptions) -> Mapping[str, bytes]:
        """Return the files; each says in its metadata which run it is of."""
        del options
        about = {"scenario": run.scenario}
        about |= {
            k: str(run.summary[k]) for k in ("seed", "policy") if k in run.summary
        }
        out = {}
        for name, table in run_tables(run).items():
            buffer = BytesIO()
            kept = table.schema.metadata or {}
            pq.write_table(
                table.replace_schema_metadata({**kept, **about}),
                buffer,
                compression="zstd",
            )
            out[f"{name}.parquet"] = buffer.getvalue()
        return out
