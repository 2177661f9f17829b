"""Chains of a graph that belong to machines, and robots without work."""

from __future__ import annotations

from planning.tasks.task import TaskKind
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph


def machine_chains(tpg: TemporalPlanGraph) -> frozenset[int]:
    """Return the indices of the chains of machines."""
    machines = {item.name for item in tpg.cell.machines}
    return frozenset(k for k, chain in enumerate(tpg.chains) if chain.robot in machines)


def working_machines(tpg: TemporalPlanGraph) -> tuple[int, ...]:
    """Return the indices of the chains of machines that process parts, and do not supply or remove any."""
    kind = {task.robot: task.kind for task in tpg.tasks}
    return tuple(
        k
        for k in sorted(machine_chains(tpg))
        if kind.get(tpg.chains[k].robot) not in TaskKind.SUPPLY
    )


def idle_robots(tpg: TemporalPlanGraph) -> tuple[str, ...]:
    """Return the robots of the cell without nodes in a graph that are not out of service."""
    out = () if tpg.cell.begun is None else tpg.cell.begun.out
    working = {*out, *(chain.robot for chain in tpg.chains if len(chain))}
    return tuple(r.name for r in tpg.cell.robots if r.name not in working)
