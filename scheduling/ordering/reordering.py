"""Reordering of the tasks of a temporal plan graph for a shorter makespan.

At first, conflicting nodes have the order of the sequential input plan (APEX-MR, section IV-C). This order can cause
unnecessary waits: one robot places a brick before another one picks, although both could do this at the same
time. So a better order of tasks is searched, and the edges are rebuilt from the same nodes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from planning.motion.speed import SpeedModel
from planning.transforms import Array
from scheduling.build_tpg import connect_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg, OccupantConflicts
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from scheduling.graph.windows import plan_cost
from scheduling.ordering.beam_search import BLOCK_GAP_S, TaskOrderSearch
from scheduling.ordering.relations import TaskRelations
from scheduling.shortcuts.candidates import find_spans

WIDTH = 24
"""Beam width; three times as many paths find nothing better in the shipped scenarios."""


def reorder_tasks(
    tpg: TemporalPlanGraph,
    speeds: Mapping[str, SpeedModel] | None = None,
    conflicts: OccupantConflicts | None = None,
) -> TemporalPlanGraph:
    """Return a graph of the same nodes with a shorter makespan, or the same graph.

    Args:
        tpg: a graph that keeps its invariant.
        speeds: speed model of each robot, where the makespan to shorten is that with transits as fast as
            along straight lines, which shortcuts come close to; by default transits take as long as they
            do. No difference where steps have time windows.
        conflicts: what was found for other graphs of the same cell.

    Raises:
        PlanInvariantError: the result breaks the invariant, a fault of this program.
    """
    if len(tpg.chains) < 2:
        return tpg
    graph = DerivedTpg(tpg)
    relations = TaskRelations(graph, conflicts)
    blocks = find_blocks(tpg.chains, relations)
    straight = speeds is not None and not tpg.windows
    durations = straight_durations(graph, speeds) if speeds and straight else None
    order = TaskOrderSearch(relations, blocks, durations).best_path(WIDTH).order()
    if order == list(range(len(blocks))):
        return tpg
    chains = put_in_order(tpg.chains, relations, [blocks[b] for b in order])
    slots = np.empty(0, dtype=np.int64)
    again = connect_nodes(DerivedTpg(replace(tpg, chains=chains, slots=slots)))
    return again if straight or plan_cost(again) < plan_cost(tpg) else tpg


def straight_durations(
    graph: DerivedTpg, speeds: Mapping[str, SpeedModel]
) -> list[Array]:
    """Return the durations of the nodes of each chain if all transit spans were straight [s].

    The nodes of a span keep their shares of its duration.

    Args:
        graph: with the nodes.
        speeds: speed model of each robot.
    """
    durations = [chain.duration.copy() for chain in graph.tpg.chains]
    for span in find_spans(graph):
        chain, which = graph.tpg.chains[span.chain], slice(span.first, span.last + 1)
        ends = chain.waypoints[chain.first[[span.first, span.last + 1]] - 1]
        direct = speeds[chain.robot].duration(ends[0], ends[1])
        lasts = float(durations[span.chain][which].sum())
        if direct < lasts:
            durations[span.chain][which] *= direct / lasts
    return durations


def find_blocks(
    chains: Sequence[NodeChain], relations: TaskRelations
) -> list[tuple[int, ...]]:
    """Return the inseparable blocks of units, in the planned order.

    Units whose planned times overlap, and that get into each other's way, take turns node by
    node: none of them could be complete before the other starts.
    """
    units = relations.units
    start = [float(chains[u.chain].planned_start[u.first]) for u in units]
    end = [
        float(
            chains[u.chain].planned_start[u.stop - 1]
            + chains[u.chain].duration[u.stop - 1]
        )
        for u in units
    ]
    by_start = sorted(range(len(units)), key=lambda u: (start[u], units[u].task))
    group = {unit: [unit] for unit in by_start}  # one list for all units of a group
    for position, a in enumerate(by_start):
        for b in by_start[position + 1 :]:
            if start[b] >= end[a] - BLOCK_GAP_S:
                break
            if units[a].chain == units[b].chain or group[a] is group[b]:
                continue
            if relations.stairs(a, b) is not None:
                group[a] += group[b]
                group.update(dict.fromkeys(group[b], group[a]))
    groups = {id(group[unit]): group[unit] for unit in by_start}.values()
    place = {unit: k for k, unit in enumerate(by_start)}
    return _in_turns(relations, [sorted(g, key=place.__getitem__) for g in groups])


def _in_turns(
    relations: TaskRelations, groups: Sequence[Sequence[int]]
) -> list[tuple[int, ...]]:
    """Return groups in order, merged where they conflict as separate ones."""
    done: Counter[int] = Counter()
    out: list[tuple[int, ...]] = []
    joined: list[int] = []
    for group in groups:
        joined += group
        units = [relations.units[unit] for unit in joined]
        after = done + Counter(unit.chain for unit in units)
        if all(unit.place < after[unit.chain] for unit in units):
            out.append(tuple(joined))
            done, joined = after, []
    return out


def put_in_order(
    chains: Sequence[NodeChain],
    relations: TaskRelations,
    order: Sequence[tuple[int, ...]],
) -> tuple[NodeChain, ...]:
    """Return chains with planned starts that put blocks one after another, in this order."""
    planned: list[Array] = [chain.planned_start.copy() for chain in chains]
    clock = 0.0
    for block in order:
        parts = [relations.units[u] for u in block]
        begin = min(float(chains[u.chain].planned_start[u.first]) for u in parts)
        latest = clock
        for u in parts:
            chain, which = chains[u.chain], slice(u.first, u.stop)
            planned[u.chain][which] = clock + (chain.planned_start[which] - begin)
            latest = max(
                latest, float(planned[u.chain][u.stop - 1] + chain.duration[u.stop - 1])
            )
        clock = latest + BLOCK_GAP_S
    return tuple(
        replace(chain, planned_start=start)
        for chain, start in zip(chains, planned, strict=True)
    )
