"""Proof that a structure cannot be assembled: bricks of which none can be the last one in.

A brick is *perhaps insertable* beside some others when nothing is found that keeps it from going
in, whichever further bricks are there or not: none of the others is in its way or in the tool's,
and even the whole design, taken as weightless, bears the press. Whatever keeps it from that keeps
it from going in beside more bricks, too. So bricks that are perhaps insertable can be set aside
one after the other, in any order; if some remain of which none is, no order of assembly exists,
as one of them would have to be the last.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

Part = TypeVar("Part")


def remaining(
    parts: Iterable[Part], perhaps: Callable[[frozenset[Part], Part], bool]
) -> frozenset[Part]:
    """Return the parts that remain when all that are perhaps insertable are set aside.

    Args:
        parts: to begin with, those that are tried first come first.
        perhaps: tells whether a part might be the last one in beside others, given them all. What
            is true for some parts must be true for fewer of them.
    """
    order = list(parts)
    left = frozenset(order)
    while True:
        before = left
        for part in order:
            if part in left and perhaps(left, part):
                left -= {part}
        if left == before:
            return left


def smallest_blocking_set(
    parts: Iterable[Part], perhaps: Callable[[frozenset[Part], Part], bool]
) -> frozenset[Part]:
    """Return parts of which none can be the last one in, and no fewer of them; none if there are.

    Args:
        parts: of the finished product, those first that should rather not be named.
        perhaps: see ``remaining``.
    """
    order = list(parts)
    core = remaining(order, perhaps)
    for part in order:
        if part in core:
            core = (
                remaining((p for p in order if p in core and p != part), perhaps)
                or core
            )
    return core
