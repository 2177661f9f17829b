"""Nodes during which a robot stands still while its tool closes or opens."""

from __future__ import annotations

import numpy as np

from planning.tasks.task import Actuation
from scheduling.graph.task_edges import task_nodes
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph


def actuation_nodes(tpg: TemporalPlanGraph) -> list[dict[int, Actuation]]:
    """Return the tool actuations of each chain (all nodes of one robot), by index of the node.

    In a contracted graph, actuations within joined nodes are left out.
    """
    return [chain_actuations(tpg, k) for k in range(len(tpg.chains))]


def chain_actuations(tpg: TemporalPlanGraph, index: int) -> dict[int, Actuation]:
    """Return the actuations of a chain by node.

    An actuation is done in the node that has a single waypoint, the one at which the task says that it ends.
    """
    chain, found = tpg.chains[index], dict[int, Actuation]()
    for nodes in task_nodes([chain])[0]:
        acts = {a.waypoint: a for a in tpg.tasks[nodes.task].actuations}
        if acts:
            first = chain.first[nodes.first : nodes.stop + 1]
            passed = (first[1:] - first[0]).tolist()
            alone = np.diff(first) == 1
            for k in np.flatnonzero(alone).tolist():
                if passed[k] in acts:
                    found[nodes.first + k] = acts[passed[k]]
    return found
