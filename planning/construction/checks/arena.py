"""Many arrays as one argument of compiled code.

Compiled functions take an array by value, field by field, and pass it on so: a hundred arrays
handed through a dozen functions cost minutes of compilation. Here they lie one after another in
a few, and each function makes views of those that it needs.

A view of an array that Python owns counts as a reference to it, atomically, when it is made and
when it is dropped: with bodies as small as a robot's links two thirds of all processor time went
into that counting. An arena is therefore nothing but addresses, and views of it count nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit, types
from numba.extending import intrinsic
from numba.np.numpy_support import carray

from planning.transforms import Array, Indices


class Arena(NamedTuple):
    """Where the tables of a ``Memory`` lie. It keeps none of them alive.

    Attributes:
        floats, integers, truths, counting: addresses of the memory's arrays.
        shape: address of where each key's table begins, its rows and its columns.
        flags: length of ``truths``.
        counts: length of ``counting``.
    """

    floats: int
    integers: int
    truths: int
    counting: int
    shape: int
    flags: int
    counts: int


@dataclass(frozen=True)
class Memory:
    """Tables of floats and rows of integers, by key. Its arena is of use as long as it lives.

    Attributes:
        floats, integers: all values.
        truths: one more array.
        counting: 0, 1, 2, ...
        shape: where each key's table begins, its rows and its columns, shape (keys, 3).
    """

    floats: Array
    integers: Indices
    truths: npt.NDArray[np.bool_]
    counting: npt.NDArray[np.int32]
    shape: Indices

    @property
    def arena(self) -> Arena:
        """Return it as an argument of compiled code."""
        return Arena(
            self.floats.ctypes.data,
            self.integers.ctypes.data,
            self.truths.ctypes.data,
            self.counting.ctypes.data,
            self.shape.ctypes.data,
            len(self.truths),
            len(self.counting),
        )


def pack(
    keys: int,
    tables: Mapping[int, Array],
    rows: Mapping[int, Indices],
    truths: npt.NDArray[np.bool_],
    counts: int,
) -> Memory:
    """Put arrays one after another.

    Args:
        keys: all keys are below this.
        tables: float arrays of any shape; the last axis becomes the columns.
        rows: integer arrays, flattened.
        truths: kept as it is.
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
    integers: list[Indices] = [np.empty(0, dtype=np.int64)]
    at = 0
    for key, whole in rows.items():
        line = np.ascontiguousarray(whole, dtype=np.int64).ravel()
        shape[key] = at, line.size, 1
        integers.append(line)
        at += line.size
    return Memory(
        np.concatenate(floats),
        np.concatenate(integers),
        np.array(truths, dtype=np.bool_),
        np.arange(max(counts, 1), dtype=np.int32),
        shape,
    )


def _pointers(number: Any, size: int) -> Any:
    """Return a function for compiled code: from an address and an offset to a pointer."""

    @intrinsic
    def pointer(typing: Any, address: Any, offset: Any) -> Any:
        kind = types.CPointer(number)

        def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            address, offset = args
            at = builder.add(address, builder.mul(offset, offset.type(size)))
            return builder.inttoptr(at, context.get_value_type(kind))

        return kind(types.int64, types.int64), code

    return pointer


_floats = _pointers(types.float64, 8)
_integers = _pointers(types.int64, 8)
_truths = _pointers(types.boolean, 1)
_counting = _pointers(types.int32, 4)


@njit(cache=True, nogil=True)
def table(arena: Arena, key: int) -> Array:
    """Return a view of a table of floats, shape (rows, columns)."""
    at, rows, columns = carray(_integers(arena.shape, 3 * key), 3)
    return carray(_floats(arena.floats, at), (rows, columns))


@njit(cache=True, nogil=True)
def column(arena: Arena, key: int) -> Array:
    """Return a view of a table of floats as one row, shape (rows * columns,)."""
    at, rows, columns = carray(_integers(arena.shape, 3 * key), 3)
    return carray(_floats(arena.floats, at), rows * columns)


@njit(cache=True, nogil=True)
def row(arena: Arena, key: int) -> Indices:
    """Return a view of a row of integers, shape (k,)."""
    at, count, _ = carray(_integers(arena.shape, 3 * key), 3)
    return carray(_integers(arena.integers, at), count)


@njit(cache=True, nogil=True)
def truths(arena: Arena) -> npt.NDArray[np.bool_]:
    """Return a view of the truth values, shape (f,)."""
    return carray(_truths(arena.truths, 0), arena.flags)


@njit(cache=True, nogil=True)
def counting(arena: Arena) -> npt.NDArray[np.int32]:
    """Return a view of 0, 1, 2, ..., shape (1, c)."""
    return carray(_counting(arena.counting, 0), (1, arena.counts))
