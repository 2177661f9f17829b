"""Many arrays as one argument of compiled code.

Compiled functions take an array by value, field by field, and pass it on so: a hundred arrays
handed through a dozen functions cost minutes of compilation. Here they lie one after another in
a few, and each function makes views of those that it needs.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from planning.transforms import Array

Integers = npt.NDArray[np.int64]


class Arena(NamedTuple):
    """Tables of floats and rows of integers, by key.

    Attributes:
        floats, integers: all values.
        flags: one more array, of truth values.
        counts: 0, 1, 2, ..., shape (1, c).
        shape: where each key's table begins, its rows and its columns, shape (keys, 3).
    """

    floats: Array
    integers: Integers
    flags: npt.NDArray[np.bool_]
    counts: npt.NDArray[np.int32]
    shape: Integers


def pack(
    keys: int,
    tables: Mapping[int, Array],
    rows: Mapping[int, Integers],
    flags: npt.NDArray[np.bool_],
    counts: int,
) -> Arena:
    """Put arrays one after another.

    Args:
        keys: all keys are below this.
        tables: float arrays of any shape; the last axis becomes the columns.
        rows: integer arrays, flattened.
        flags: kept as it is.
        counts: length of the counting array.
    """
    shape = np.zeros((keys, 3), dtype=np.int64)
    floats: list[Array] = [np.empty(0)]
    at = 0
    for key, value in tables.items():
        flat = np.ascontiguousarray(value, dtype=np.float64)
        columns = flat.shape[-1] if flat.ndim > 1 else 1
        shape[key] = at, flat.size // max(columns, 1), columns
        floats.append(flat.ravel())
        at += flat.size
    integers: list[Integers] = [np.empty(0, dtype=np.int64)]
    at = 0
    for key, whole in rows.items():
        line = np.ascontiguousarray(whole, dtype=np.int64).ravel()
        shape[key] = at, line.size, 1
        integers.append(line)
        at += line.size
    return Arena(
        np.concatenate(floats),
        np.concatenate(integers),
        np.array(flags, dtype=np.bool_),
        np.arange(max(counts, 1), dtype=np.int32)[None],
        shape,
    )


@njit(cache=True)
def table(arena: Arena, key: int) -> Array:
    """Return a view of a table of floats, shape (rows, columns)."""
    at, rows, columns = arena.shape[key]
    return arena.floats[at : at + rows * columns].reshape(rows, columns)


@njit(cache=True)
def column(arena: Arena, key: int) -> Array:
    """Return a view of a table of floats as one row, shape (rows * columns,)."""
    at, rows, columns = arena.shape[key]
    return arena.floats[at : at + rows * columns]


@njit(cache=True)
def row(arena: Arena, key: int) -> Integers:
    """Return a view of a row of integers, shape (k,)."""
    at, count, _ = arena.shape[key]
    return arena.integers[at : at + count]
