"""Timing graphs: plans without geometry, as only time matters once paths are known to be safe.

A timing graph is a TemporalPlanGraph that can be executed and sent anywhere, but not drawn: a
few hundred kilobytes for the plan of an assembly of hundreds of steps, less when contracted.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planning.cell.body import Capsules, ConvexBody
from planning.cell.workcell import CellObject, Workcell
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph

_NO_BODY = ConvexBody(
    "none", np.zeros((0, 3)), Capsules(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
)


def timing_graph(tpg: TemporalPlanGraph) -> TemporalPlanGraph:
    """Return a plan, contracted or not, without robots' models, shapes, poses and paths."""
    return replace(
        tpg,
        cell=bare_cell({item.name: item.kind for item in tpg.cell.objects}),
        tasks=tuple(replace(t, path=np.zeros((0, 0)), handlings=()) for t in tpg.tasks),
        chains=tuple(_bare_chain(chain) for chain in tpg.chains),
        handlings=(),
        allowed=(),
    )


def bare_cell(kinds: dict[str, str]) -> Workcell:
    """Return a cell without robots in which objects have a name and a kind, and nothing else."""
    items = tuple(
        CellObject(name, kind, np.zeros(3), np.eye(4), _NO_BODY)
        for name, kind in kinds.items()
    )
    return Workcell((), (), items)


def _bare_chain(chain: NodeChain) -> NodeChain:
    return replace(
        chain,
        start=np.zeros(0),
        waypoints=np.zeros((0, 0)),
        fraction=np.zeros(0),
        first=np.zeros(len(chain) + 1, dtype=np.int64),
    )
