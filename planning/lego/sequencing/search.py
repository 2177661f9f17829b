"""Search for an assembly sequence: depth first, again and again with what dead ends have taught.

Each try goes depth first, up to a number of partial structures. At a dead end the bricks that
nothing but the press keeps from going in have lost what would have borne it: they become urgent
and are removed earlier in the next try. No partial structure that led nowhere is entered again,
so tries without end would be a complete search, and the last one takes all that is left.
"""

from __future__ import annotations

from dataclasses import dataclass

from planning.lego.insertion.insertion import Insertion
from planning.lego.sequencing.disassembly import Removal, find_assembly_sequence
from planning.lego.sequencing.prospects import Prospects
from planning.lego.sequencing.removals import Removals
from planning.lego.stability.partial_structures import Names
from planning.progress import Progress, no_progress

_FIRST_TRY = 30
"""Partial structures that the first try may look at beyond one for each brick."""


@dataclass(frozen=True)
class SequenceSearch:
    """Result of a search.

    Attributes:
        steps: removals in the order of assembly, None where none was found.
        dead_end: smallest partial structure of which nothing could be removed, None without one.
        visited: partial structures looked at.
        complete: True where every order was tried.
    """

    steps: tuple[Removal[str, Insertion], ...] | None
    dead_end: Names | None
    visited: int
    complete: bool


def search_sequence(
    parts: Names,
    removals: Removals,
    prospects: Prospects,
    *,
    limit: int,
    progress: Progress = no_progress,
) -> SequenceSearch:
    """Search for an order in which bricks can be put together.

    Args:
        parts: of the finished structure.
        removals: what may be removed from which partial structure.
        prospects: what might be removed if the structure bore it.
        limit: largest number of partial structures to look at, beyond one for each brick.
        progress: told after each try how many were looked at, and of how many at most.
    """
    failed: set[Names] = set()
    visited, beyond = 0, _FIRST_TRY
    dead_end: Names | None = None
    total = limit + len(parts) + 1
    while True:
        most = min(len(parts) + 1 + beyond, total - visited)
        found = find_assembly_sequence(parts, removals.of, limit=most, failed=failed)
        visited += found.visited
        progress(visited, total)
        end = found.dead_end
        if end is not None and (dead_end is None or len(end) < len(dead_end)):
            dead_end = end
        if found.steps is not None or found.complete or visited >= total:
            return SequenceSearch(found.steps, dead_end, visited, found.complete)
        if end is not None:
            removals.urgency.update(n for n in end if prospects.perhaps(end, n))
        beyond += beyond // 2
