"""The two engines are one truth: equal to the nanosecond in every replication."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.timing_graphs import SCENARIOS, contracted_graph, load_timing_graph
from planning.errors import PlanInvariantError
from scheduling.build_tpg import build_tpg
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.shipped_runs import ShippedRuns
from tests.twin.drawn_runs import TPGS, VARIED
from tests.twin.simulated import assert_same_ends, run_bulk
from tests.twin.twin_toys import random_tpg, with_cut_skill
from twin.durations.bounded import Uniform
from twin.durations.measured import packaged_timings
from twin.durations.normal import Lognormal
from twin.engine.bulk.bulk_engine import BulkEngine
from twin.engine.bulk.max_plus import Past, end_times, policy_graph
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel, Messages
from twin.run.events import Policy
from twin.study.replications.workload import timing_graph
from twin.uncertainty.contraction import contract
from twin.uncertainty.disturbances import Disturbances, FixedFactor, Speed, Stalls
from twin.uncertainty.skill_durations import SkillDurations

DURATIONS = SkillDurations(
    {
        "pick": Uniform(low_s=0.2, high_s=5.0),
        "place-down": Lognormal(median_s=2.0, p95_s=9.0),
    }
)


def _in_slots(tpg: TemporalPlanGraph) -> TemporalPlanGraph:
    """Give every robot's k-th pair of tasks the same slot."""
    slots = np.zeros(len(tpg.tasks), dtype=np.int64)
    for chain in tpg.chains:
        for place, task in enumerate(dict.fromkeys(chain.task.tolist())):
            slots[task] = place // 2
    none = np.empty((0, 4), dtype=np.int64)
    return replace(tpg, slots=slots, edges=none, cause=np.empty(0, dtype=np.uint8))


@settings(max_examples=50, deadline=None)
@given(
    st.integers(0, 10**6),
    st.integers(1, 4),
    st.sampled_from(["asynchronous", "sequential", "open-loop"]),
    st.sampled_from([0.5, 1.0, 2.0]),
    st.booleans(),
)
def test_engines_agree_to_the_nanosecond(
    seed: int, robots: int, policy: Policy, speed: float, cut: bool
) -> None:
    """Whoever is early by the planned clock waits for it in every node."""
    edges = 10 if robots > 1 and not cut else 0
    tpg = random_tpg(seed, dofs=(2,) * robots, edges=edges)
    tpg = with_cut_skill(tpg) if cut else tpg
    factor = FixedFactor(kind="fixed", value=speed)
    quick = Disturbances(speed=Speed(factor=factor) if speed != 1.0 else Speed())
    model = ExecutionModel(DURATIONS, policy, disturbances=quick)
    assert_same_ends(tpg, model, seed, range(5, 9))


def test_engines_agree_in_slots() -> None:
    tpg = _in_slots(random_tpg(3, dofs=(2, 2, 2), tasks=12, edges=4))
    model = ExecutionModel(DURATIONS, "synchronous")
    found = assert_same_ends(tpg, model, 1, range(8)).makespan_ns
    asynchronous = BulkEngine(tpg, ExecutionModel(DURATIONS))
    assert np.any(
        run_bulk(asynchronous, seed=1, replications=range(8)).makespan_ns < found
    )


def test_slots_are_asked_for() -> None:
    with pytest.raises(PlanInvariantError, match="not made in slots"):
        BulkEngine(random_tpg(0), ExecutionModel(DURATIONS, "synchronous"))


def test_replications_do_not_know_of_each_other() -> None:
    tpg = random_tpg(8, dofs=(2, 2, 2), edges=12)
    engine = BulkEngine(tpg, ExecutionModel(DURATIONS))
    together = run_bulk(engine, seed=2, replications=range(200)).makespan_ns
    apart = [
        run_bulk(engine, seed=2, replications=[r]).makespan_ns[0]
        for r in (0, 63, 64, 199)
    ]
    assert together[[0, 63, 64, 199]].tolist() == apart


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


FOLDER = Path(__file__).parents[2] / "timing_graphs"
GRAPHS = sorted(FOLDER.glob("*.npz"))


def test_every_bundled_scenario_has_its_graph() -> None:
    assert {path.stem for path in GRAPHS} == set(SCENARIOS)


@pytest.mark.parametrize("policy", ["asynchronous", "sequential"])
@pytest.mark.parametrize("path", GRAPHS, ids=lambda path: path.stem)
def test_engines_agree(path: Path, policy: Policy) -> None:
    model = ExecutionModel(SkillDurations(packaged_timings()), policy)
    assert_same_ends(load_timing_graph(path), model, 4, [0, 1, 77])


@pytest.mark.nightly
def test_the_graph_of_the_cliff_is_current(shipped: ShippedRuns) -> None:
    plan = shipped("lego/cliff").planned.motions.motion_plan
    assert_current("cliff", timing_graph(contract(build_tpg(plan)).tpg))


def test_a_graph_that_is_made_anew_is_the_one_that_is_kept() -> None:
    assert_current("rearrangement", contracted_graph(SCENARIOS["rearrangement"]))


def assert_current(name: str, now: TemporalPlanGraph) -> None:
    kept = load_timing_graph(FOLDER / f"{name}.npz")
    assert [task.label for task in kept.tasks] == [task.label for task in now.tasks]
    assert np.array_equal(kept.edges, now.edges)
    for ours, theirs in zip(kept.chains, now.chains, strict=True):
        assert np.array_equal(ours.task, theirs.task)
        assert np.allclose(ours.duration, theirs.duration, atol=1e-6)
