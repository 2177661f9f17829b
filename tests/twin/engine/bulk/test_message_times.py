"""Longest paths with messages and short queues, against the event engine."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.drawn_runs import TPGS, VARIED
from twin.engine.bulk.max_plus import Past, end_times, policy_graph
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel, Messages
from twin.uncertainty.disturbances import Disturbances, Stalls

LATENCIES = st.sampled_from([0.0, 0.001, 0.1, 0.7])
POLICIES = st.sampled_from(["asynchronous", "sequential", "open-loop"])


def simulator(
    tpg: TemporalPlanGraph, policy: str, depth: int, report: float, release: float
) -> Simulator:
    stalls = Stalls(count_per_robot=1, duration_s=(0.5, 3.0))
    model = ExecutionModel(
        VARIED,
        policy,  # type: ignore[arg-type]
        Messages.of_seconds(depth, report, release),
        Disturbances(stalls=stalls),
    )
    return Simulator(tpg, model)


@settings(max_examples=80, deadline=None)
@given(TPGS, st.integers(0, 100), POLICIES, st.integers(1, 5), LATENCIES, LATENCIES)
def test_end_times_are_those_of_the_event_engine(
    tpg: TemporalPlanGraph,
    seed: int,
    policy: str,
    depth: int,
    report: float,
    release: float,
) -> None:
    engine = simulator(tpg, policy, depth, report, release)
    runs = [engine.run(seed=seed, replication=r) for r in range(3)]
    busy = np.stack(
        [
            np.concatenate([*run.duration_ns]) + np.concatenate([*run.stood_ns])
            for run in runs
        ],
        axis=1,
    )
    graph = policy_graph(tpg, policy)  # type: ignore[arg-type]
    talk = Messages.of_seconds(depth, report, release).under(policy)  # type: ignore[arg-type]
    end = end_times(graph, busy, talk)
    assert np.array_equal(end.T, [np.concatenate(run.end_ns) for run in runs])


@settings(max_examples=40, deadline=None)
@given(
    TPGS, st.integers(0, 100), st.integers(1, 5), LATENCIES, LATENCIES, st.floats(0, 1)
)
def test_what_has_happened_changes_nothing_about_what_will(
    tpg: TemporalPlanGraph,
    seed: int,
    depth: int,
    report: float,
    release: float,
    share: float,
) -> None:
    """The rest of a run, known durations given, is the run."""
    run = simulator(tpg, "asynchronous", depth, report, release).run(seed=seed)
    now = int(share * run.makespan_ns)
    start, end = np.concatenate(run.start_ns), np.concatenate(run.end_ns)
    started, done = start <= now, end <= now
    busy = np.concatenate([*run.duration_ns]) + np.concatenate([*run.stood_ns])
    busy = np.where(started & ~done, end - now, busy)
    graph = policy_graph(tpg, "asynchronous")
    past = Past(
        now,
        np.where(started, start, -1),
        np.where(done, end, -1),
        np.zeros((len(tpg.chains), 1), dtype=np.int64),
    )
    talk = Messages.of_seconds(depth, report, release)
    assert np.array_equal(end_times(graph, busy[:, None], talk, past)[:, 0], end)
