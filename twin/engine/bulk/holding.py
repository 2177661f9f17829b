"""Holding back what opens windows of time, by the forecast of when the later steps will be ready.

The forecast of a step is the longest path that is left to it, with durations that are drawn as in runs, in the
plan without limits of acceleration and messages: each node takes its nominal time but for what varies.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.windows import with_holds
from twin.engine.bulk.max_plus import OTHER
from twin.engine.execution_model import ExecutionModel
from twin.uncertainty.contraction import uncontracted
from twin.uncertainty.node_times import NodeTimeSampler

_SEED = 7_919
"""Of the draws of forecasts, beside those of the runs."""

_DRAWS, _MOST_VALUES = 2000, 10_000_000


def held_back(tpg: TemporalPlanGraph, model: ExecutionModel) -> TemporalPlanGraph:
    """Return a graph in which what opens windows waits as the execution model says; see ``with_holds``.

    Only where robots wait for each other by the plan: a planned clock, turns and slots hold back themselves.

    Args:
        tpg: the plan.
        model: how it is executed, and what varies.
    """
    timed = any(window.most is not None for window in tpg.windows)
    if not timed or model.hold <= 0.0 or model.policy != "asynchronous":
        return tpg
    free = replace(tpg, chains=tuple(replace(c, drive=None) for c in tpg.chains))
    nodes = sum(len(chain) for chain in tpg.chains)
    draws = np.arange(max(50, min(_DRAWS, _MOST_VALUES // nodes)))
    sampler = NodeTimeSampler(free, model.durations, model.disturbances)
    times = sampler.sample_segments(uncontracted(free), seed=_SEED, replications=draws)
    busy = np.ascontiguousarray(times.busy_ns, dtype=np.int64)
    return with_holds(tpg, busy, model.hold, OTHER)
