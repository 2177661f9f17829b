"""One run of a graph, with everything said in one call."""

from __future__ import annotations

from collections.abc import Sequence

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.engine.bulk.bulk_engine import BulkEngine
from twin.engine.bulk.max_plus import Completions
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel, Messages
from twin.recorders.observers import Recorder
from twin.run.events import ExecutionRecord, Policy
from twin.uncertainty.disturbances import Disturbances
from twin.uncertainty.skill_durations import SkillDurations


def simulate(
    tpg: TemporalPlanGraph,
    durations: SkillDurations,
    *,
    seed: int,
    replication: int = 0,
    policy: Policy = "asynchronous",
    messages: Messages | None = None,
    disturbances: Disturbances | None = None,
    recorders: Sequence[Recorder] = (),
) -> ExecutionRecord:
    """Execute a graph once."""
    model = ExecutionModel(
        durations, policy, messages or Messages(), disturbances or Disturbances()
    )
    return Simulator(tpg, model).run(
        seed=seed, replication=replication, recorders=recorders
    )


def run_bulk(
    engine: BulkEngine, *, seed: int, replications: Sequence[int]
) -> Completions:
    """Execute replications side by side; nodes are segments of the engine's contraction."""
    times = engine.sample(seed=seed, replications=replications)
    return engine.execute(times)
