"""Attempts at a skill that failed, as nodes of what was executed.

A robot that did not succeed stands where the skill begins: it has gone back along its own path, which is
part of what the skill occupies. So the node needs nobody else to wait, and what follows is planned from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planning.tasks.task import FAILED, Handling
from planning.transforms import readonly
from scheduling.graph.drive import Drive
from scheduling.graph.task_edges import machine_chains
from scheduling.graph.temporal_plan_graph import (
    NodeChain,
    NodeHandling,
    TemporalPlanGraph,
)
from scheduling.rolling.cut import stands_at
from scheduling.rolling.extension import (
    allowed_during,
    joined_parts,
    left_out,
    merged,
)


def with_attempt(
    committed: TemporalPlanGraph,
    tpg: TemporalPlanGraph,
    robot: str,
    node: int,
    changes: Sequence[Handling] = (),
    *,
    missing: bool = False,
) -> TemporalPlanGraph:
    """Return committed nodes with one more, in which a robot has tried a skill and stands where it was.

    Args:
        committed: of a graph, up to the node; see ``committed_part``.
        tpg: the graph.
        robot: who tried.
        node: the first node of the skill.
        changes: what has become of the object, at waypoint 1.
        missing: whether what it is about was not there, so that it waited for no machine to bring it.
    """
    whole = tpg.chains[tpg.chain_index[robot]]
    index = int(whole.task[node])
    q = readonly(stands_at(whole, node).copy())
    stood = NodeChain(
        robot,
        q,
        q[None],
        np.ones(1),
        np.array([0, 1]),
        np.array([index]),
        np.ones(1, dtype=np.bool_),
        whole.duration[node : node + 1].copy(),
        whole.planned_start[node : node + 1].copy(),
        drive=None if whole.drive is None else _still(),
    )
    old = committed.chain_index
    if robot in old:
        at = old[robot]
        chains = list(committed.chains)
        chains[at] = joined_parts([chains[at], stood])
    else:
        at, chains = len(committed.chains), [*committed.chains, stood]
    own = tpg.chain_index[robot]
    place = {chain.robot: k for k, chain in enumerate(chains)}
    brings = machine_chains(tpg) if missing else frozenset[int]()
    rows = [
        row
        for row, (k, _, i, v) in enumerate(tpg.edges.tolist())
        if (i, v) == (own, node) and k not in brings
    ]
    into = [
        (place[tpg.chains[k].robot], u, at, node)
        for k, u, _, _ in tpg.edges[rows].tolist()
    ]
    task = replace(
        tpg.tasks[index],
        kind=FAILED,
        label=f"{tpg.tasks[index].label}: failed",
        path=q[None],
        handlings=tuple(changes),
        actuations=(),
        goal=False,
    )
    tasks = [
        *committed.tasks,
        *map(left_out, tpg.tasks[len(committed.tasks) : index + 1]),
    ]
    tasks[index] = task
    handled = [
        NodeHandling(h.object, at, node, h.waypoint, h.holder, h.pose) for h in changes
    ]
    return replace(
        committed,
        tasks=tuple(tasks),
        chains=tuple(chains),
        edges=np.concatenate(
            [committed.edges, np.array(into, dtype=np.int64).reshape(-1, 4)]
        ),
        cause=np.concatenate([committed.cause, tpg.cause[rows]]),
        handlings=(*committed.handlings, *handled),
        allowed=merged((*committed.allowed, *allowed_during(tpg.allowed, {index}))),
    )


def _still() -> Drive:
    """Return how a node without motion is passed."""
    none, one = np.zeros(1), np.ones(1)
    rests, by = np.ones(1, dtype=np.bool_), np.zeros(1, dtype=np.int64)
    return Drive(none, none, none, rests, one, by, one)
