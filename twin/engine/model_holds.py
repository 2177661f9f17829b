"""Additional waits in a plan: those of a registered dispatch policy, and those that keep time windows.

If a step must begin within a maximum time after an earlier task, the earlier task is delayed until the step
is likely to begin in time.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.windows import with_window_hold_edges
from twin.engine.dispatch_policies import with_policy
from twin.engine.execution_model import OTHER, ExecutionModel
from twin.registry import POLICIES
from twin.uncertainty.contraction import Contraction
from twin.uncertainty.node_times import NodeTimeSampler

_SEED = 7_919
"""Seed of the draws of forecasts, separate from those of runs."""

_DRAWS, _MOST_VALUES = 2000, 10_000_000


def with_model_holds(
    tpg: TemporalPlanGraph, model: ExecutionModel
) -> TemporalPlanGraph:
    """Return a graph with the waits of a registered policy, and with delays of tasks that open time windows.

    Tasks are held back, see ``with_window_hold_edges``, only under asynchronous release: a planned clock,
    turns and slots hold tasks back by themselves. A later step is forecast by the longest remaining path
    to it, with durations drawn as in runs, without acceleration limits and messages.

    Args:
        tpg: the plan.
        model: execution model, with disturbances.

    Raises:
        RequestError: a registered policy returned what are no edges, or edges in a circle.
    """
    if model.policy not in POLICIES.own:
        tpg = with_policy(tpg, model.policy, OTHER)
    timed = any(window.most is not None for window in tpg.windows)
    if not timed or model.hold <= 0.0 or model.policy != "asynchronous":
        return tpg
    free = replace(tpg, chains=tuple(replace(c, drive=None) for c in tpg.chains))
    nodes = sum(len(chain) for chain in tpg.chains)
    draws = np.arange(max(50, min(_DRAWS, _MOST_VALUES // nodes)))
    sampler = NodeTimeSampler(free, model.durations, model.disturbances)
    times = sampler.sample_segments(
        Contraction.trivial(free), seed=_SEED, replications=draws
    )
    busy = np.ascontiguousarray(times.busy_ns, dtype=np.int64)
    return with_window_hold_edges(tpg, busy, model.hold, OTHER)
