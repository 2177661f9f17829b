"""Parallel map over all processors that this process may use."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def usable_cores() -> int:
    """Return the number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def map_in_parallel(
    function: Callable[[Item], Result], items: Iterable[Item]
) -> list[Result]:
    """Apply a function to all items in parallel; return results in the order of the items.

    Args:
        function: runs in several threads concurrently; compiled code releases the interpreter's lock.
        items: what it is called with.
    """
    work = list(items)
    workers = min(len(work), usable_cores())
    if workers <= 1:
        return [function(item) for item in work]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(function, work))
