"""The structure of a saved plan: no cycle, the planned order, and objects passed on in order."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from scheduling.graph.temporal_plan_graph import NodeHandling, TemporalPlanGraph
from scheduling.verification.ancestors import Precedence, find_precedence
from scheduling.verification.findings import Moment, Problem
from scheduling.verification.object_places import (
    handled_objects,
    planned_key,
    stand_during,
)

_Node = tuple[int, int]


def check_structure(
    tpg: TemporalPlanGraph,
) -> tuple[Precedence | None, list[Problem]]:
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
        for robot in {holder, event.holder} - {None, tpg.chains[event.robot].robot}:
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


def _problem(
    tpg: TemporalPlanGraph, kind: str, u: _Node, v: _Node, text: str
) -> Problem:
    first, second = (
        Moment(chain.robot, node, int(chain.task[node]), False, chain.robot)
        for chain, node in ((tpg.chains[a], n) for a, n in (u, v))
    )
    names = [f"node {m.node} of {m.robot!r} (task {m.task})" for m in (first, second)]
    message = f"{names[0]} and {names[1]}: {text}"
    return Problem(kind, message, first, second)
