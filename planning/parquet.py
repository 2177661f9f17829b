"""Reading of Parquet result files, with limits on their size."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from planning.errors import OutputError
from planning.files import open_regular

if TYPE_CHECKING:
    import pyarrow as pa

_MOST_CELLS = 50_000_000
"""Largest number of values in a table; its columns may have 8 bytes for each value of this limit."""


_NAMES = ("string", "dictionary<values=string, indices=int32, ordered=0>")
_LIST, _FIXED = "list<element: double>", "fixed_size_list<element: double>"
_COLUMNS = {
    "trajectory.parquet": {"t_s": ("double",), "robot": _NAMES, "node": ("int64",)},
    "objects.parquet": {
        "t_s": ("double",),
        "object": _NAMES,
        "parent": _NAMES,
        "xyz": (f"{_FIXED}[3]", _LIST),
        "quat_wxyz": (f"{_FIXED}[4]", _LIST),
    },
}
"""Columns that tables of a run have, without empty cells, and their types; others are of joints."""

_LENGTHS = {"xyz": 3, "quat_wxyz": 4}
"""Length of each list of a column."""


def read_parquet(path: Path) -> pa.Table:
    """Return the table of a Parquet file; its size is checked before it is decoded.

    Raises:
        OutputError: it cannot be read, is no Parquet file, has more values than ``_MOST_CELLS``, or, by
            the name of the file, other columns than a table of a run.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with open_regular(path) as source, pq.ParquetFile(source) as file:
            about = file.metadata
            groups = [about.row_group(k) for k in range(about.num_row_groups)]
            rows = max(about.num_rows, sum(group.num_rows for group in groups))
            size = sum(group.total_byte_size for group in groups)
            if rows * max(about.num_columns, 1) > _MOST_CELLS or size > 8 * _MOST_CELLS:
                raise OutputError(
                    f"{path}: has {rows} rows of {about.num_columns} columns: that is too much to be"
                    " of this program"
                )
            table: pa.Table = file.read()
            table.validate()
    except (OSError, ValueError, MemoryError, pa.ArrowException) as error:
        raise OutputError(f"{path}: cannot be read: {error}") from error
    columns = _COLUMNS.get(path.name)
    if columns is None:
        return table
    there = {field.name: str(field.type) for field in table.schema}
    for name, kinds in (dict.fromkeys(there, ("double",)) | columns).items():
        if there.get(name) not in kinds:
            raise OutputError(
                f"{path}: column {name} is {there.get(name, 'missing')}, not {kinds[0]}"
            )
        if name in columns and not _is_whole(table.column(name), _LENGTHS.get(name, 0)):
            raise OutputError(f"{path}: column {name} has cells without a value")
    return table


def _is_whole(column: pa.ChunkedArray, length: int) -> bool:
    """Tell whether a column has a value (or list of the right length) in every cell, all numbers finite."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if column.null_count:
        return False
    if length:
        if set(pc.list_value_length(column).unique().to_pylist()) - {length}:
            return False
        column = pc.list_flatten(column)
    if not pa.types.is_floating(column.type):
        return True
    return bool(
        not column.null_count and pc.all(pc.is_finite(column)).as_py() in (True, None)
    )
