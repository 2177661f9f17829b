"""Forecasts: exact where everything is known, honest where it is not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.drawn_runs import TPGS, VARIED, sample_node_times
from tests.twin.simulated import NOMINAL, watched
from tests.twin.twin_toys import random_tpg, two_robot_tpg
from twin.durations.bounded import Fixed, Uniform
from twin.durations.lifetimes import Exponential
from twin.durations.lognormal import Lognormal
from twin.durations.measured import MeasuredTimes
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel, Messages
from twin.follow.forecast import SEED, Forecaster, conditional_quantiles
from twin.follow.state import FollowedRun
from twin.recorders.observers import MemoryRecorder
from twin.runs.events import Event
from twin.uncertainty.disturbances import (
    Breakdowns,
    Disturbances,
    SkillFailure,
    Speed,
    Stalls,
    UniformFactor,
)
from twin.uncertainty.skill_durations import SkillDurations

SPREAD = SkillDurations(
    {
        skill: Lognormal(median_s=5.0, p95_s=12.0)
        for skill in ("pick", "place-down", "place-up", "handover")
    }
)
U = (np.arange(400) + 0.5) / 400


# Durations that have lasted for some time


def test_longer_than_a_bound_of_a_uniform_is_uniform_above_it() -> None:
    found = conditional_quantiles(Uniform(low_s=2.0, high_s=6.0), 3.0, U)
    assert found == pytest.approx(3.0 + 3.0 * U, abs=1e-6)


def test_what_has_no_memory_begins_afresh() -> None:
    model = Exponential(mean_s=4.0)
    assert conditional_quantiles(model, 7.0, U) == pytest.approx(
        7.0 + model.ppf(U), abs=1e-6
    )


def test_of_measured_times_only_the_longer_ones_are_left() -> None:
    values = np.array([1.0, 2.0, 2.0, 3.0, 5.0, 8.0])
    found = conditional_quantiles(MeasuredTimes(values=tuple(values)), 2.0, U)
    left, counts = np.unique(found, return_counts=True)
    assert left.tolist() == [3.0, 5.0, 8.0]
    assert counts / len(U) == pytest.approx([1 / 3] * 3, abs=0.01)
    assert np.all(
        conditional_quantiles(MeasuredTimes(values=tuple(values)), 9.0, U) == 9.0
    )
    assert np.all(conditional_quantiles(Fixed(value_s=3.0), 1.0, U) == 3.0)


# Forecasts


@settings(max_examples=30, deadline=None)
@given(
    TPGS,
    st.sampled_from(["asynchronous", "sequential", "open-loop"]),
    st.sampled_from([0.0, 0.3]),
    st.integers(1, 3),
)
def test_before_it_begins_a_run_is_any_run(
    tpg: TemporalPlanGraph, policy: str, latency: float, depth: int
) -> None:
    """The futures are the replications of the event engine, to the nanosecond."""
    disturbances = Disturbances(
        jitter=Uniform(low_s=0.0, high_s=0.1),
        stalls=Stalls(rate_per_h=300.0, duration=Uniform(low_s=1.0, high_s=2.0)),
        failures={"pick": SkillFailure(probability=0.3, retries=0)},
    )
    model = ExecutionModel(
        VARIED,
        policy,
        Messages.of_seconds(depth, latency, latency),
        disturbances,
    )
    engine = Simulator(tpg, model)
    forecast = Forecaster(tpg, model, samples=12).forecast(FollowedRun(tpg))
    times = [
        sample_node_times(tpg, VARIED, disturbances, seed=SEED, replication=r)
        for r in range(12)
    ]
    failing = [max(drawn.failed) >= 0 for drawn in times]
    good = [r for r in range(12) if not failing[r]]
    ends = [engine.run(seed=SEED, replication=r).makespan_s for r in good]
    assert forecast.makespan_s.tolist() == sorted(ends)
    assert forecast.failing == pytest.approx(np.mean(failing))


@settings(max_examples=30, deadline=None)
@given(TPGS, st.integers(1, 3), st.sampled_from([0.0, 0.3]))
def test_without_chance_the_end_is_known_at_any_time(
    tpg: TemporalPlanGraph, depth: int, latency: float
) -> None:
    messages = Messages.of_seconds(depth, latency, latency)
    run, events = watched(tpg, messages=messages)
    model = ExecutionModel(NOMINAL, messages=messages)
    forecaster = Forecaster(tpg, model, samples=2)
    followed = FollowedRun(tpg)
    last = -1
    for event in events:
        if event.t_ns > last >= 0:  # all that happens at one time has happened
            for now in (last, (last + event.t_ns) // 2):
                found = forecaster.forecast(followed, now).makespan_s
                assert found == pytest.approx([run.makespan_s] * 2, abs=1e-6)
        followed.apply(event)
        last = event.t_ns


def seen_from(
    engine: Simulator, forecaster: Forecaster, seed: int, share: float
) -> tuple[float, np.ndarray]:
    """The makespan of a run, and what was foreseen when a share of it was over."""
    recorder = MemoryRecorder()
    run = engine.run(seed=seed, recorders=[recorder])
    followed = FollowedRun(engine.tpg)
    now = int(share * run.makespan_ns)
    for event in recorder.events:
        if event.t_ns > now:
            break
        followed.apply(event)
    return run.makespan_s, forecaster.forecast(followed, now).makespan_s


def test_forecasts_bracket_the_truth_as_often_as_they_say() -> None:
    """Of 150 runs nine in ten end before their P90, half before their P50."""
    slow = UniformFactor(kind="uniform", low=0.5, high=1.0)
    broken = Breakdowns(mtbf_s=60.0, mttr_s=4.0)
    disturbances = Disturbances(
        speed=Speed(robots={"robot_0": slow}), breakdowns=broken
    )
    tpg = random_tpg(16, tasks=14, edges=12)
    model = ExecutionModel(SPREAD, disturbances=disturbances)
    engine, forecaster = Simulator(tpg, model), Forecaster(tpg, model, samples=120)
    ranks = []
    for seed in range(150):
        truth, futures = seen_from(engine, forecaster, seed, 0.4)
        ranks.append(np.mean(futures <= truth))
    below = [np.mean(np.array(ranks) <= p) for p in (0.1, 0.5, 0.9)]
    for p, share in zip((0.1, 0.5, 0.9), below, strict=True):
        assert abs(share - p) < 3.5 * np.sqrt(p * (1 - p) / 150) + 0.01


def test_forecasts_become_surer() -> None:
    tpg = random_tpg(16, tasks=14, edges=12)
    model = ExecutionModel(SPREAD)
    engine, forecaster = Simulator(tpg, model), Forecaster(tpg, model)
    spreads = [
        np.mean([np.std(seen_from(engine, forecaster, s, share)[1]) for s in range(12)])
        for share in (0.0, 0.5, 0.9)
    ]
    assert spreads[0] > spreads[1] > spreads[2]


def test_the_pace_of_a_motion_is_learnt_while_it_lasts() -> None:
    """Nodes of 1 s each; the first took 2 s, so the others of that task will too."""
    tpg = two_robot_tpg([(0, 2, 1, 0)])
    followed = FollowedRun(tpg)
    followed.apply(Event(0, "robot_0", "started", 0, 0))
    followed.apply(Event(2 * 10**9, "robot_0", "completed", 0, 0))
    followed.apply(Event(2 * 10**9, "robot_0", "started", 0, 1))
    found = Forecaster(tpg, ExecutionModel(NOMINAL), samples=3).forecast(
        followed, 3 * 10**9
    )
    assert found.makespan_s.tolist() == [9.0] * 3


def test_a_robot_that_stands_makes_the_end_later() -> None:
    tpg = two_robot_tpg([])
    stalls = Disturbances(stalls=Stalls(count_per_robot=1, duration_s=(2.0, 6.0)))
    followed = FollowedRun(tpg)
    followed.apply(Event(0, "robot_0", "started", 0, 0))
    forecaster = Forecaster(tpg, ExecutionModel(NOMINAL, disturbances=stalls))
    followed.apply(Event(0, "robot_0", "stalled", 0, 0))
    early, late = (forecaster.forecast(followed, t * 10**9) for t in (0, 5))
    assert late.quantile(0.5) > early.quantile(0.5)
    # It has stood for 5 s and will for at most one more; then come 3 s of motion.
    assert late.makespan_s.min() >= 8.0
    failed = FollowedRun(tpg)
    failed.apply(Event(0, "robot_0", "started", 0, 0))
    failed.apply(Event(0, "robot_0", "failed", 0, 0))
    found = forecaster.forecast(failed)
    assert found.failing == 1.0
    assert np.isnan(found.quantile(0.5))
