"""Parquet files of results, read within bounds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from planning.errors import OutputError
from planning.files import open_regular

if TYPE_CHECKING:
    import pyarrow as pa

MOST_CELLS = 50_000_000
"""Most values of a table, and one eighth of the bytes that its columns take."""


def read_parquet(path: Path) -> pa.Table:
    """Return the table of a Parquet file; its size is known before any of it is decoded.

    Raises:
        OutputError: it cannot be read, is no Parquet file, or has more values than ``MOST_CELLS``.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with open_regular(path) as source, pq.ParquetFile(source) as file:
            about = file.metadata
            groups = [about.row_group(k) for k in range(about.num_row_groups)]
            rows = max(about.num_rows, sum(group.num_rows for group in groups))
            size = sum(group.total_byte_size for group in groups)
            if rows * max(about.num_columns, 1) > MOST_CELLS or size > 8 * MOST_CELLS:
                raise OutputError(
                    f"{path}: has {rows} rows of {about.num_columns} columns: that is too much to be"
                    " of this program"
                )
            table: pa.Table = file.read()
            table.validate()
            return table
    except (OSError, ValueError, MemoryError, pa.ArrowException) as error:
        raise OutputError(f"{path}: cannot be read: {error}") from error
