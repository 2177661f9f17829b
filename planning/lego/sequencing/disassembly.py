"""Assembly by disassembly: a depth-first search from the finished product (APEX-MR App. A).

Free of any domain: parts are anything hashable, what may be removed is asked of the caller. The
reversed order of removals is the assembly sequence.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

Part = TypeVar("Part", bound=Hashable)
How = TypeVar("How")


@dataclass(frozen=True)
class Removal(Generic[Part, How]):
    """Removal of one part; reversed, its insertion.

    Attributes:
        part: what is taken away.
        how: whatever the caller wants to remember of it.
    """

    part: Part
    how: How


@dataclass(frozen=True)
class DisassemblySearch(Generic[Part, How]):
    """Result of a search for an assembly sequence.

    Attributes:
        steps: removals in the order of assembly, None when there is no sequence.
        dead_end: a smallest set of parts, reached by removals, of which none can be removed;
            None when the search never got stuck.
        visited: number of sets of parts looked at.
        complete: False when the search gave up because of its limit.
    """

    steps: tuple[Removal[Part, How], ...] | None
    dead_end: frozenset[Part] | None
    visited: int
    complete: bool


def find_assembly_sequence(
    parts: Iterable[Part],
    removals: Callable[[frozenset[Part]], Iterable[Removal[Part, How]]],
    *,
    limit: int = 100_000,
    failed: set[frozenset[Part]] | None = None,
) -> DisassemblySearch[Part, How]:
    """Search for an order in which parts can be put together.

    Args:
        parts: the parts of the finished product.
        removals: gives the parts that may be removed from a set of parts, and how, the
            preferred ones first; it is only asked for as many as are needed. It must depend on
            nothing but its argument, but for the order.
        limit: largest number of sets of parts to look at.
        failed: sets of parts that are known to lead nowhere, from which no search starts again;
            those of this search are added.

    Returns:
        The first sequence in the order of preference: removals are tried depth first, and a set
        of parts that once led nowhere is never tried again.
    """
    whole = frozenset(parts)
    failed = set() if failed is None else failed
    dead_end: frozenset[Part] | None = None
    visited = 1
    # Sets of parts, each with the removal that led there and those to try from there.
    way: list[
        tuple[
            frozenset[Part],
            tuple[Removal[Part, How], ...],
            Iterator[Removal[Part, How]],
        ]
    ]
    way = [(whole, (), iter(removals(whole) if whole else ()))]
    while way and way[-1][0]:
        here, _, pending = way[-1]
        step = next((r for r in pending if here - {r.part} not in failed), None)
        if step is None:
            failed.add(here)
            way.pop()
            if dead_end is None or len(here) < len(dead_end):
                dead_end = here
        elif visited >= limit:
            return DisassemblySearch(None, dead_end, visited, False)
        else:
            visited += 1
            rest = here - {step.part}
            way.append((rest, (step,), iter(removals(rest) if rest else ())))
    steps = tuple(step for _, steps, _ in reversed(way) for step in steps)
    return DisassemblySearch(steps if way else None, dead_end, visited, True)
