"""Priority queue of candidate motions along the edges of a roadmap: a heap in compiled code."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planning.kernels import copy_row, inner_kernel
from planning.packed import packed
from planning.transforms import Array, Indices

MOST = 40_000
"""Capacity of the queue: greatest number of motions."""


class Motions(NamedTuple):
    """Priority queue of motions, as a heap.

    Attributes:
        size: how many motions there are, shape (1,).
        key: least arrival at a goal, shape (MOST,) [s].
        depart: departure, likewise [s].
        edge: from which span of which vertex, to which, and how often it has been tried, shape
            (MOST, 3).
    """

    size: Indices
    key: Array
    depart: Array
    edge: Indices


def empty_motions() -> Motions:
    """Return an empty heap, as kernels take it."""
    return packed(
        Motions(
            np.zeros(1, dtype=np.int64),
            np.empty(MOST),
            np.empty(MOST),
            np.empty((MOST, 3), dtype=np.int64),
        )
    )


@inner_kernel
def push_motion(
    heap: Motions, key: float, depart: float, source: int, target: int, tries: int
) -> None:
    """Add a motion, unless the queue is full."""
    k = heap.size[0]
    if k == MOST:
        return
    heap.size[0] += 1
    while k > 0 and heap.key[(k - 1) // 2] > key:
        up = (k - 1) // 2
        heap.key[k], heap.depart[k] = heap.key[up], heap.depart[up]
        copy_row(heap.edge[k], heap.edge[up])
        k = up
    heap.key[k], heap.depart[k] = key, depart
    heap.edge[k, 0], heap.edge[k, 1], heap.edge[k, 2] = source, target, tries


@inner_kernel
def pop_motion(heap: Motions) -> None:
    """Remove the motion with the least key."""
    heap.size[0] -= 1
    size = heap.size[0]
    if size == 0:
        return
    k = size * 0
    key = heap.key[size]
    while 2 * k + 1 < size:
        down = 2 * k + 1
        if down + 1 < size and heap.key[down + 1] < heap.key[down]:
            down += 1
        if heap.key[down] >= key:
            break
        heap.key[k], heap.depart[k] = heap.key[down], heap.depart[down]
        copy_row(heap.edge[k], heap.edge[down])
        k = down
    heap.key[k], heap.depart[k] = key, heap.depart[size]
    copy_row(heap.edge[k], heap.edge[size])
