"""The structure of a saved plan: no cycle, the planned order, and objects passed on in order.

Precedence of nodes comes from ancestor sets, as bits of integers.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise

import numpy as np

from planning.tasks.task import GONE
from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import NodeHandling, TemporalPlanGraph
from scheduling.verification.object_places import (
    handled_objects,
    planned_key,
    stand_during,
)

_Node = tuple[int, int]


@dataclass(frozen=True)
class Moment:
    """One side of a problem.

    Attributes:
        robot: name of the robot, None for what rests in the world.
        node: the node, or the node before which the robot stands, -1 where there is none.
        task: its task, -1 where there is none.
        standing: True when the robot stands before the node.
        body: what comes close: ``"<robot>/arm"``, ``"<robot>/tool"``, object or fixture.
    """

    robot: str | None
    node: int
    task: int
    standing: bool
    body: str

    def __str__(self) -> str:
        """Describe it in one phrase."""
        if self.robot is None:
            return f"{self.body} at rest"
        if self.standing:
            return f"{self.body} of {self.robot!r} standing before node {self.node}"
        return f"{self.body} of {self.robot!r} in node {self.node} (task {self.task})"


@dataclass(frozen=True)
class Problem:
    """A violation of the guarantee.

    Attributes:
        kind: ``"cycle"``, ``"order"`` (an edge or a chain against the planned order),
            ``"dependency"``, ``"handling"``, ``"jump"`` (of an object), ``"task"`` (what is done is
            not what the task says), ``"path"`` (a robot jumps), ``"nodes"``, ``"hold"``, ``"rest"``,
            ``"itself"`` (a robot touches itself, or what it carries) or ``"grip"`` (what is in a
            hand is too deep in it).
        message: one sentence.
        first, second: the two sides, None for a cycle, and where there is one side.
        distance_m: distance measured where it was first seen, NaN where none was [m].
    """

    kind: str
    message: str
    first: Moment | None = None
    second: Moment | None = None
    distance_m: float = math.nan


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
    problems = list(_against_the_order(tpg))
    for name, events in handled_objects(tpg).items():
        problems += _unordered_handlings(tpg, precedence, name, events)
        problems += _moving_holders(tpg, precedence, name, events)
    problems += _dependencies_not_kept(tpg, precedence)
    return precedence, problems


def _against_the_order(tpg: TemporalPlanGraph) -> Iterator[Problem]:
    for a, chain in enumerate(tpg.chains):
        for v in range(1, len(chain)):
            if planned_key(tpg, a, v) < planned_key(tpg, a, v - 1):
                yield _problem(
                    tpg, "order", (a, v - 1), (a, v), "against the planned order"
                )
    for a, u, b, v in tpg.edges.tolist():
        if planned_key(tpg, a, u) >= planned_key(tpg, b, v):
            text = "an edge against the planned order"
            yield _problem(tpg, "order", (a, u), (b, v), text)


def _unordered_handlings(
    tpg: TemporalPlanGraph,
    precedence: Precedence,
    name: str,
    events: list[NodeHandling],
) -> Iterator[Problem]:
    for before, after in pairwise(events):
        u, v = (before.robot, before.node), (after.robot, after.node)
        if u[0] != v[0] and not precedence.precedes(*u, *v):
            text = f"both handle {name!r} and are not ordered"
            yield _problem(tpg, "handling", u, v, text)


def _moving_holders(
    tpg: TemporalPlanGraph,
    precedence: Precedence,
    name: str,
    events: list[NodeHandling],
) -> Iterator[Problem]:
    """Yield where a robot need not stand still while another one gives it something or takes it."""
    index = tpg.chain_index
    holder: str | None = None
    for event in events:
        here = event.robot, event.node
        for robot in {holder, event.holder} - {
            None,
            GONE,
            tpg.chains[event.robot].robot,
        }:
            b = index[str(robot)]
            v = stand_during(tpg, b, (*here, event.waypoint))[1]
            text = f"{name!r} is passed on and {robot!r} need not stand then"
            if v > 0 and not precedence.precedes(b, v - 1, *here):
                yield _problem(tpg, "handling", (b, v - 1), here, text)
            if v < len(tpg.chains[b]) and not precedence.precedes(*here, b, v):
                yield _problem(tpg, "handling", here, (b, v), text)
        holder = event.holder


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
                yield _problem(tpg, "dependency", u, v, text)


def node_problem(tpg: TemporalPlanGraph, kind: str, node: _Node, text: str) -> Problem:
    """Return a problem of one node, by chain and number."""
    moment, name = _named(tpg, node)
    return Problem(kind, f"{name}: {text}", moment)


def _problem(
    tpg: TemporalPlanGraph, kind: str, u: _Node, v: _Node, text: str
) -> Problem:
    (first, one), (second, other) = _named(tpg, u), _named(tpg, v)
    return Problem(kind, f"{one} and {other}: {text}", first, second)


def _named(tpg: TemporalPlanGraph, node: _Node) -> tuple[Moment, str]:
    chain, number = tpg.chains[node[0]], node[1]
    task = int(chain.task[number])
    moment = Moment(chain.robot, number, task, False, chain.robot)
    return moment, f"node {number} of {chain.robot!r} (task {task})"


_BLOCK = 4096
"""Nodes whose ancestors are counted at once: it bounds the memory."""


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
        """Return how many of the first nodes of chain b need not wait for node u of chain a."""
        return int(np.searchsorted(self.complete[a][b], u, side="right"))


def find_precedence(tpg: TemporalPlanGraph) -> Precedence | None:
    """Return the order that type-1 and type-2 edges impose, None if they form a cycle."""
    lengths = [len(chain) for chain in tpg.chains]
    first = np.cumsum([0, *lengths]).tolist()
    total = first[-1]
    sources: list[list[int]] = [[] for _ in range(total)]
    for a, length in enumerate(lengths):
        for v in range(1, length):
            sources[first[a] + v].append(first[a] + v - 1)
    for a, u, b, v in tpg.edges.tolist():
        sources[first[b] + v].append(first[a] + u)
    try:
        order = list(TopologicalSorter(dict(enumerate(sources))).static_order())
    except CycleError:
        return None
    complete = [[np.zeros(n, dtype=np.int64) for n in lengths] for _ in lengths]
    for a, length in enumerate(lengths):
        for start in range(0, length, _BLOCK):
            stop = min(start + _BLOCK, length)
            counts = _ancestors(sources, order, first[a] + start, first[a] + stop)
            for b in range(len(lengths)):
                complete[a][b] += counts[first[b] : first[b + 1]]
    return Precedence(tuple(tuple(row) for row in complete))


def _ancestors(
    sources: list[list[int]], order: list[int], start: int, stop: int
) -> Indices:
    """Return, for every node, how many of the nodes ``range(start, stop)`` precede it."""
    bits = [0] * len(sources)
    for v in order:
        mine = 0
        for u in sources[v]:
            mine |= bits[u]
            if start <= u < stop:
                mine |= 1 << (u - start)
        bits[v] = mine
    return np.array([b.bit_count() for b in bits], dtype=np.int64)
