"""Independent pieces of work on all processors; compiled code lets go of the interpreter."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from planning.processors import usable_cores

Item = TypeVar("Item")
Result = TypeVar("Result")


def side_by_side(
    function: Callable[[Item], Result], items: Iterable[Item]
) -> list[Result]:
    """Return what a function makes of every item, in the order of the items.

    Args:
        function: may run in several threads at once.
        items: what it is called with.
    """
    work = list(items)
    workers = min(len(work), usable_cores())
    if workers <= 1:
        return [function(item) for item in work]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(function, work))
