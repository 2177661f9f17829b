"""Temporal plan graph of plans that are executed one after another, made from the conflicts between two plans at a time.

Let P1, P2, ... be the plans of the sequence, in order, of which few are distinct. Every plan is proved by itself, with
everything in its cell that is at rest meanwhile. In addition, the conflicts of the nodes of any two distinct plans
are searched, of the one executed earlier and the one executed later. Contacts are allowed only within one execution of
a plan, so these conflicts are the same wherever in the sequence the two plans are. An execution m of plan b waits, for
each plan a, only for the last execution of a before m: if a node conflicts with a node u of a, it conflicts with the u
of every earlier execution, and the nodes of a robot are executed in order.

The safety invariant holds for the whole. (a) Conflicting nodes are ordered: those of one execution by its own edges,
those of two by the edges between their plans. (b) Let node v conflict with a robot at rest between two nodes u and w.
Then v conflicts with both, and need only be examined if it is between u and w in the total order. If all three belong
to one execution, its plan was proved. If w belongs to a later execution than u, the robot is at HOME, at which each
plan begins and ends with the same tool in hand, which is checked; then v belongs to the end of the execution of u, the beginning of that of w, or one between in
which the robot has no nodes, and each of these plans was proved with the robot at HOME. (c) Let node v conflict with an
object at rest from node p to node q. Likewise, v need only be examined if it is between p and q. The object is then at
rest in the cell of the plan of v: plans begin with the objects at rest with which the ones before end, which is checked.
That plan was proved with this object.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from planning.geometry.robot_bodies import entity_numbers
from planning.transforms import Indices
from scheduling.build_tpg import connect_nodes
from scheduling.conflicts.allowed_contacts import contact_table
from scheduling.conflicts.conflict_search import search_conflicts
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.conflicts.object_spans import Rest
from scheduling.conflicts.occupancy import Occupancy
from scheduling.graph.task_edges import dependency_edges
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    TASK_DEPENDENCY,
    TemporalPlanGraph,
)
from scheduling.graph.total_order import NodeOrder, transitive_reduction
from scheduling.sequences.sequence import PlanSequence, SequenceNodes


def splice_plans(sequence: PlanSequence) -> TemporalPlanGraph:
    """Return the graph of a sequence of plans, reduced and proved safe.

    Args:
        sequence: the plans; their type-2 edges are not used.

    Raises:
        PlanInvariantError: a robot or object at rest is in the way of a motion in the same plan, or is not where the
            next plan begins with it.
    """
    nodes = SequenceNodes(sequence)
    graph = DerivedTpg(nodes.graph())
    plans = list(map(_with_all_rests, sequence.plans, sequence.moved()))
    proved = [connect_nodes(plan).edges for plan in plans]
    between = _edges_between(plans)
    tasks = dependency_edges(graph.tpg)
    order = [segment.plan for segment in sequence.segments]
    motions = [nodes.edges(proved[plan], m, m) for m, plan in enumerate(order)]

    def search(n: int, m: int, known: NodeOrder | None) -> None:
        for i, k in nodes.unordered(n, m, known):
            if len(edges := between(order[n], k, order[m], i)):
                motions.append(nodes.edges(edges, n, m))

    for m in range(1, len(order)):
        search(m - 1, m, None)
    # With dependencies, these order most robots after all that was done in plans before the last one.
    known = transitive_reduction(graph.ranks, np.concatenate([tasks, *motions]))[0]
    last: dict[int, int] = {}
    for m, plan in enumerate(order):
        for n in last.values():
            search(n, m, known)
        last[plan] = m
    edges = np.concatenate([tasks, _last_sources(np.concatenate(motions))])
    cause = np.full(len(edges), MOTION_CONFLICT, dtype=np.uint8)
    cause[: len(tasks)] = TASK_DEPENDENCY
    return graph.with_edges(edges, cause).tpg


def _with_all_rests(plan: TemporalPlanGraph, moved: Collection[str]) -> DerivedTpg:
    """Return a plan with the rests of objects that only other plans handle, see ``PlanSequence.moved``."""
    graph, handled = DerivedTpg(plan), {h.object for h in plan.handlings}
    still = tuple(
        Rest(item.name, None, None, item.start)
        for item in plan.cell.objects
        if item.name in moved and item.name not in handled and not item.later
    )
    names = dict.fromkeys(
        [h.object for h in plan.handlings] + [x.object for x in still]
    )
    entities = entity_numbers((robot.name for robot in plan.cell.robots), names)
    history = replace(graph.history, rests=(*graph.history.rests, *still))
    return graph.derive(plan, "ranks", entities=entities, history=history)


def _last_sources(edges: Indices) -> Indices:
    """Return of the edges from one chain to one node the last one only, shape (e, 4)."""
    edges = edges[np.lexsort((edges[:, 1], edges[:, 0], edges[:, 3], edges[:, 2]))]
    same = np.all(edges[1:, [0, 2, 3]] == edges[:-1, [0, 2, 3]], axis=1)
    return np.asarray(edges[~np.append(same, np.zeros(min(len(edges), 1), bool))])


def _edges_between(
    plans: Sequence[DerivedTpg],
) -> Callable[[int, int, int, int], Indices]:
    """Return a function that returns the edges to a chain of a plan from a chain of one executed earlier, shape (e, 4).

    Its arguments are the earlier plan and its chain, and the later one and its chain. Their objects are different ones,
    whatever their names: what is done to the same object is ordered by tasks.
    """
    cell = plans[0].tpg.cell
    robots = len(entity_numbers((robot.name for robot in cell.robots), ()))
    objects = max(len(plan.entities) for plan in plans) - robots
    numbers = {str(k): k for k in range(robots + 2 * objects)}
    table = contact_table(numbers, len(cell.robots), (), cell.clearances)

    @cache
    def occupancies(plan: int, shift: int) -> list[Occupancy]:
        own = plans[plan]
        entities = {
            name: k if k < robots else k + shift for name, k in own.entities.items()
        }
        same = "ranks", "history", "spans"
        return own.derive(own.tpg, *same, entities=entities).occupancies

    @cache
    def edges(earlier: int, k: int, later: int, i: int) -> Indices:
        before, after = plans[earlier].tpg.chains[k], plans[later].tpg.chains[i]
        found: list[tuple[int, int, int, int]] = []
        if after.robot != before.robot:
            a, b = occupancies(later, objects)[i], occupancies(earlier, 0)[k]
            floor, limit = np.full(len(after), -1), np.full(len(after), len(before))
            conflicts = search_conflicts(a, b, floor, limit, table)
            found = [(k, u, i, v) for v, u in conflicts]
        return np.array(found, dtype=np.int64).reshape(-1, 4)

    return edges
