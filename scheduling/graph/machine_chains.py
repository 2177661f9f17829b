"""The chains of a graph that belong to machines, see ``planning.cell.machine``."""

from __future__ import annotations

from planning.tasks.supply_tasks import SUPPLY_KINDS
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph


def machine_chains(tpg: TemporalPlanGraph) -> frozenset[int]:
    """Return the indices of the chains whose tasks no robot does.

    The tasks say so: a graph that is kept without its cell knows it, too.
    """
    return frozenset(
        k
        for k, chain in enumerate(tpg.chains)
        if len(chain) and tpg.tasks[int(chain.task[0])].kind in SUPPLY_KINDS
    )
