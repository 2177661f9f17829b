"""Export of the tables of a run as CSV and Parquet: events, trajectories, object poses.

CSV follows RFC 4180: a header line, and empty fields for missing values. Units are SI units.
"""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from twin.trial.run_result import RunResult

_COMPONENTS = {"xyz": ("x", "y", "z"), "quat_wxyz": ("qw", "qx", "qy", "qz")}


def csv_files(run: RunResult) -> Mapping[str, bytes]:
    """Return ``events.csv``, ``trajectory.csv`` and ``objects.csv``, with one column for each vector component."""
    return {f"{name}.csv": _csv(table) for name, table in _tables(run).items()}


def parquet_files(run: RunResult) -> Mapping[str, bytes]:
    """Return the same tables as Parquet, zstd compressed.

    The metadata of each file names its scenario, seed and policy.
    """
    about = {"scenario": run.name}
    about |= {k: str(run.summary[k]) for k in ("seed", "policy") if k in run.summary}
    out = {}
    for name, table in _tables(run).items():
        buffer = BytesIO()
        kept = table.schema.metadata or {}
        pq.write_table(
            table.replace_schema_metadata({**kept, **about}), buffer, compression="zstd"
        )
        out[f"{name}.parquet"] = buffer.getvalue()
    return out


def _tables(run: RunResult) -> Mapping[str, pa.Table]:
    """Return the tables ``events``, ``trajectory`` and ``objects``, as in the run folder."""
    return {
        "events": run.events,
        "trajectory": run.trajectory,
        "objects": run.objects,
    }


def _csv(table: pa.Table) -> bytes:
    columns = {}
    for name in table.column_names:
        column = table.column(name).combine_chunks()
        if name in _COMPONENTS:
            size = len(_COMPONENTS[name])
            values = column.flatten()
            for k, component in enumerate(_COMPONENTS[name]):
                columns[component] = values.take(
                    pa.array(range(k, len(values), size), pa.int64())
                )
        elif pa.types.is_dictionary(column.type):
            columns[name] = column.cast(pa.string())
        else:
            columns[name] = column
    buffer = BytesIO()
    pa.csv.write_csv(pa.table(columns), buffer)
    return buffer.getvalue()
