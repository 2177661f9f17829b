"""One run of a graph, with everything said in one call."""

from collections.abc import Sequence
from typing import Any

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.bulk.bulk_engine import BulkEngine
from twin.bulk.max_plus import Completions
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel, Messages
from twin.recorders.observers import MemoryRecorder, Recorder
from twin.runs.events import Event
from twin.runs.execution_record import ExecutionRecord, Policy
from twin.uncertainty.disturbances import Disturbances, EmergencyStop
from twin.uncertainty.skill_durations import SkillDurations

NOMINAL = SkillDurations({})
"""Skills take as long as planned."""


def simulate(
    tpg: TemporalPlanGraph,
    durations: SkillDurations = NOMINAL,
    *,
    seed: int = 0,
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


def watched(
    tpg: TemporalPlanGraph, durations: SkillDurations = NOMINAL, **options: Any
) -> tuple[ExecutionRecord, list[Event]]:
    """Execute a graph once, and return what recorders are told, too."""
    recorder = MemoryRecorder()
    return simulate(tpg, durations, recorders=[recorder], **options), recorder.events


def stopped(
    at_s: float, duration_s: float, robot: str | None = None, **more: Any
) -> Disturbances:
    """Return an emergency stop, by default of everyone, and whatever else disturbs."""
    stop = EmergencyStop(robot=robot, at_s=at_s, duration_s=duration_s)
    return Disturbances(emergency_stops=(stop,), **more)


def run_bulk(
    engine: BulkEngine, *, seed: int, replications: Sequence[int]
) -> Completions:
    """Execute replications side by side; nodes are segments of the engine's contraction."""
    times = engine.sample(seed=seed, replications=replications)
    return engine.execute(times)


def assert_same_ends(
    tpg: TemporalPlanGraph, model: ExecutionModel, seed: int, numbers: Sequence[int]
) -> Completions:
    """Check that every robot is done, and has waited as long, in the same nanosecond in both engines."""
    found = run_bulk(BulkEngine(tpg, model), seed=seed, replications=numbers)
    events = Simulator(tpg, model)
    for column, replication in enumerate(numbers):
        run = events.run(seed=seed, replication=replication)
        assert run.outcome == "completed"
        assert run.makespan_ns == found.makespan_ns[column]
        for k in range(len(tpg.chains)):
            assert run.end_ns[k][-1] == found.chain_end_ns[k, column]
            assert run.wait_ns(k) == found.waited_ns[k, :, column].sum()
    return found
