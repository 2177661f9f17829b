"""The figures of a run: ``summary.json``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from scheduling.graph.rollout import earliest_times
from scheduling.graph.task_edges import dependency_edges
from scheduling.graph.temporal_plan_graph import TASK_DEPENDENCY, TemporalPlanGraph
from twin.durations import NANOSECONDS
from twin.run.run_record import Run


def summarise(
    tpg: TemporalPlanGraph,
    run: Run,
    *,
    scenario: str,
    planning_s: Mapping[str, float] | None = None,
    audit: Mapping[str, Any] | None = None,
    makespan_sequential_s: float | None = None,
) -> dict[str, Any]:
    """Return the figures of a run, with the keys of ``summary.json``.

    Args:
        tpg: what was executed.
        run: how.
        scenario: its name.
        planning_s: wall-clock seconds of the planning stages.
        audit: configurations, min_distance_m and violations, None when there was no audit.
        makespan_sequential_s: makespan of the plan before it became a TPG; by default that of
            the same nodes with the same durations, one robot at a time.
    """
    if makespan_sequential_s is None:
        total_ns = sum(int(t.sum()) for t in (*run.duration_ns, *run.stall_ns))
        makespan_sequential_s = total_ns / NANOSECONDS

    def seconds(of: Callable[[int], int]) -> dict[str, float]:
        return {c.robot: of(k) / NANOSECONDS for k, c in enumerate(tpg.chains)}

    return {
        "scenario": scenario,
        "seed": run.seed,
        "policy": run.policy,
        "outcome": run.outcome,
        "makespan_s": run.makespan_s,
        "makespan_sequential_s": makespan_sequential_s,
        "lower_bound_s": lower_bound_s(tpg, run),
        "wait_s": seconds(run.wait_ns),
        "stall_s": seconds(run.stalled_ns),
        "stopped_s": seconds(lambda k: run.halted_ns(k, run.makespan_ns)),
        "failure": run.failure or None,
        "nodes": sum(len(chain) for chain in tpg.chains),
        "type2_edges": len(tpg.edges),
        "planning_s": dict(planning_s or {}),
        "audit": None if audit is None else dict(audit),
    }


def lower_bound_s(tpg: TemporalPlanGraph, run: Run) -> float:
    """Return a makespan that no coordination of these paths can beat [s].

    It is the longest path through the robots' own nodes and the task dependencies, as if no two
    robots were ever in each other's way.
    """
    edges = dependency_edges(tpg)
    cause = np.full(len(edges), TASK_DEPENDENCY, dtype=np.uint8)
    free = replace(tpg, edges=edges, cause=cause)
    busy = [d + s for d, s in zip(run.duration_ns, run.stall_ns, strict=True)]
    ends = [e[-1] for e in earliest_times(free, busy).end if len(e)]
    return float(np.max(ends, initial=0)) / NANOSECONDS
