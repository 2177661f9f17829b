"""The critical path of a structure: parts that can only be placed one after another."""

from __future__ import annotations

from graphlib import TopologicalSorter

from planning.contacts.precedence import PartGraph


def longest_chain(graph: PartGraph, *, carried: bool = True) -> tuple[str, ...]:
    """Return parts that can only be placed one after another.

    However many robots build, their placements follow each other. With ``carried`` it is the
    longest chain of parts each of which rests on the one before; or the longest of the shortest
    ways from the ground, whichever has more parts.
    """
    best = _shortest_way_up(graph)
    if carried:
        best = max(best, _longest_pile(graph), key=len)
    return best


def _shortest_way_up(graph: PartGraph) -> tuple[str, ...]:
    chain: dict[str, tuple[str, ...]] = {
        part: (part,) for part in graph.neighbours if part in graph.ground
    }
    front = list(chain)
    last: tuple[str, ...] = ()
    for part in front:  # grows while it is gone through: breadth first
        last = chain[part]
        for near in sorted(graph.neighbours[part]):
            if near not in chain:
                chain[near] = (*chain[part], near)
                front.append(near)
    return last


def _longest_pile(graph: PartGraph) -> tuple[str, ...]:
    known: dict[str, tuple[str, ...]] = {}
    for part in TopologicalSorter(graph.carriers).static_order():
        below = (known[other] for other in sorted(graph.carriers[part]))
        known[part] = (*max(below, key=len, default=()), part)
    return max(known.values(), key=len, default=())
