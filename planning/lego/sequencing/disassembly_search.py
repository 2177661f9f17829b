"""Search for an assembly sequence: repeated depth-first searches that learn from dead ends.

Each search visits a limited number of partial structures. At a dead end, some bricks cannot be inserted only because
the bricks that would bear the press force have been removed. The next search removes these bricks earlier. Partial
structures that led to a dead end are not visited again, so without a limit the search would be complete. The last
search may use all of the remaining limit.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby, product
from typing import Generic, TypeVar

from planning.lego.insertion.insertion import Insertion, Insertions
from planning.lego.insertion.rules import InsertionMethod
from planning.lego.stability.partial_structures import Names

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
        visited: number of sets of parts examined.
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
    """Search for an order in which parts can be assembled.

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
    stack: list[
        tuple[
            frozenset[Part],
            tuple[Removal[Part, How], ...],
            Iterator[Removal[Part, How]],
        ]
    ]
    stack = [(whole, (), iter(removals(whole) if whole else ()))]
    while stack and stack[-1][0]:
        here, _, pending = stack[-1]
        step = next((r for r in pending if here - {r.part} not in failed), None)
        if step is None:
            failed.add(here)
            stack.pop()
            if dead_end is None or len(here) < len(dead_end):
                dead_end = here
        elif visited >= limit:
            return DisassemblySearch(None, dead_end, visited, False)
        else:
            visited += 1
            rest = here - {step.part}
            stack.append((rest, (step,), iter(removals(rest) if rest else ())))
    steps = tuple(step for _, steps, _ in reversed(stack) for step in steps)
    return DisassemblySearch(steps if stack else None, dead_end, visited, True)


class Removals:
    """Removal candidates of the partial structures of one design.

    These are the conditions of assembly by disassembly (APEX-MR App. A): the remaining structure must
    stand, the tools must have room to insert the brick again, and the structure must bear the press force.

    Args:
        insertions: of the design.

    Attributes:
        urgency: how often a brick could not be removed any more at a dead end; the most urgent
            bricks are removed first.
    """

    def __init__(self, insertions: Insertions) -> None:
        self._insertions = insertions
        self.urgency: Counter[str] = Counter()

    def of(self, parts: Names) -> Iterator[Removal[str, Insertion]]:
        """Yield the bricks that may be removed from some bricks (and fixed ones).

        Urgent ones come first, then those at the top.
        """
        names = parts | self._insertions.fixed
        bricks = self._insertions.structures.bricks

        def order(name: str) -> tuple[int, int, int, int, str]:
            cell = bricks[name].cell
            return -self.urgency[name], -cell.level, -cell.x, -cell.y, name

        ordered = sorted(parts, key=order)
        for _, group in groupby(ordered, key=lambda name: order(name)[:2]):
            for method, brick in product(InsertionMethod, tuple(group)):
                if method not in self._insertions.rules.methods_of(brick):
                    continue
                insertion = self._insertions.last(names, brick, method)
                if insertion is not None:
                    yield Removal(brick, insertion)
