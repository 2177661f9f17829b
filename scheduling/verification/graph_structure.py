"""Checks of the structure of a saved plan: no cycles, edges in planned order, and unambiguous order of handlings.

A handling is a pick, placement or handover of an object. Precedence of nodes is computed from their first
descendants in each chain, from the ends of the chains on.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planning.tasks.task import Handling
from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.object_places import (
    ObjectLocation,
    object_locations,
    planned_key,
    stand_during,
)
from scheduling.verification.problems import Problem, pair_problem

_Node = tuple[int, int]


def check_structure(tpg: TemporalPlanGraph) -> tuple[Precedence | None, list[Problem]]:
    """Check order, handlings and dependencies.

    Args:
        tpg: the plan.

    Returns:
        What precedes what, None if there is a cycle, and the problems.
    """
    precedence = find_precedence(tpg)
    if precedence is None:
        return None, [Problem("cycle", "the edges form a cycle")]
    problems = list(_order_problems(tpg))
    for name, places in object_locations(tpg).items():
        problems += _unordered_handlings(tpg, precedence, name, places)
    problems += _dependencies_not_kept(tpg, precedence)
    return precedence, problems


def _order_problems(tpg: TemporalPlanGraph) -> Iterator[Problem]:
    for a, chain in enumerate(tpg.chains):
        for v in range(1, len(chain)):
            if planned_key(tpg, a, v) < planned_key(tpg, a, v - 1):
                yield pair_problem(
                    tpg, "order", (a, v - 1), (a, v), "against the planned order"
                )
    for a, u, b, v in tpg.edges.tolist():
        if planned_key(tpg, a, u) >= planned_key(tpg, b, v):
            text = "an edge against the planned order"
            yield pair_problem(tpg, "order", (a, u), (b, v), text)


def _unordered_handlings(
    tpg: TemporalPlanGraph,
    precedence: Precedence,
    name: str,
    places: Sequence[ObjectLocation],
) -> Iterator[Problem]:
    """Yield unordered handlings of an object.

    A robot has to stand still, too, while another one gives it something or takes it.
    """
    for at in places:
        if at.put is not None and at.taken is not None:
            u, v = at.put[:2], at.taken[:2]
            if u[0] != v[0] and not precedence.precedes(*u, *v):
                text = f"both handle {name!r} and are not ordered"
                yield pair_problem(tpg, "handling", u, v, text)
    for before, after in pairwise(places):
        assert after.put is not None
        here, own = after.put[:2], tpg.chains[after.put[0]].robot
        for robot in {before.holder, after.holder} - {None, Handling.GONE, own}:
            b = tpg.chain_index[str(robot)]
            leaves = stand_during(tpg, b, after.put)[1]
            came, goes = (b, leaves - 1), (b, leaves)
            text = f"{name!r} is passed on and {robot!r} need not stand then"
            if leaves > 0 and not precedence.precedes(*came, *here):
                yield pair_problem(tpg, "handling", came, here, text)
            if leaves < len(tpg.chains[b]) and not precedence.precedes(*here, *goes):
                yield pair_problem(tpg, "handling", here, goes, text)


def _dependencies_not_kept(
    tpg: TemporalPlanGraph, precedence: Precedence
) -> Iterator[Problem]:
    starts: dict[int, _Node] = {}
    ends: dict[int, _Node] = {}
    for a, chain in enumerate(tpg.chains):
        for node, task in enumerate(chain.task.tolist()):
            starts.setdefault(task, (a, node))
            ends[task] = (a, node)
    for first, second in tpg.dependencies.tolist():
        if first in ends and second in starts:
            u, v = ends[first], starts[second]
            if not precedence.precedes(*u, *v):
                text = f"task {second} must wait for task {first}, and does not"
                yield pair_problem(tpg, "dependency", u, v, text)


@dataclass(frozen=True)
class Precedence:
    """Precedence between nodes.

    Attributes:
        complete: ``complete[a][b][v]`` is how many of the first nodes of chain ``a`` must be
            complete before node ``v`` of chain ``b`` may start.
    """

    complete: tuple[tuple[Indices, ...], ...]

    def precedes(self, a: int, u: int, b: int, v: int) -> bool:
        """Tell whether node u of chain a must be complete before node v of chain b starts."""
        return bool(self.complete[a][b][v] > u)

    def not_after(self, a: int, u: int, b: int) -> int:
        """Return the number of first nodes of chain b that need not wait for node u of chain a."""
        return int(np.searchsorted(self.complete[a][b], u, side="right"))


def find_precedence(tpg: TemporalPlanGraph) -> Precedence | None:
    """Return the order that type-1 and type-2 edges impose, None for a cycle."""
    lengths = [len(chain) for chain in tpg.chains]
    targets: dict[_Node, list[_Node]] = {}
    for a, u, b, v in tpg.edges.tolist():
        targets.setdefault((a, u), []).append((b, v))
    # The first node of each chain that comes after a node; by chain, its last node first.
    later: list[list[list[int]]] = [[] for _ in lengths]
    found_some = True
    while found_some:
        found_some = False
        for a, own in enumerate(later):
            while (u := lengths[a] - 1 - len(own)) >= 0:
                after = targets.get((a, u), ())
                if any(len(later[b]) < lengths[b] - v for b, v in after):
                    break
                first = [*own[-1]] if own else [*lengths]
                first[a] = u + 1
                for b, v in after:
                    first = list(map(min, first, later[b][lengths[b] - 1 - v]))
                    first[b] = min(first[b], v)
                own.append(first)
                found_some = True
    if any(len(own) < length for own, length in zip(later, lengths, strict=True)):
        return None
    tables = [np.array(own[::-1]).reshape(-1, len(lengths)) for own in later]
    return Precedence(
        tuple(
            tuple(
                np.searchsorted(table[:, b], np.arange(length), side="right")
                for b, length in enumerate(lengths)
            )
            for table in tables
        )
    )
