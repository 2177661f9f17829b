"""The two engines are one truth: equal to the nanosecond in every replication.

So with machines and with robots on hold; sums along the longest ways against a plain loop.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.timing_graphs import SCENARIOS, contracted_graph, load_timing_graph
from planning.errors import PlanInvariantError
from scheduling.build_tpg import build_tpg
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    TASK_DEPENDENCY,
    TemporalPlanGraph,
)
from scheduling.motion_times import with_full_speed_times
from scheduling.sequences.copies import copies_in_sequence
from scheduling.sequences.splice import splice_plans
from tests.scheduling.graph.test_windows import plain_times, windowed_tpg
from tests.scheduling.line_world import line_plan
from tests.shipped_runs import ShippedRuns
from tests.twin.drawn_runs import TPGS, VARIED
from tests.twin.driven_toys import driven_tpg, with_limits
from tests.twin.simulated import assert_same_ends, run_bulk, watched
from tests.twin.twin_toys import random_tpg, with_cut_skill
from twin.bulk.bulk_engine import BulkEngine
from twin.bulk.max_plus import (
    Completions,
    Past,
    PrecedenceArrays,
    end_times,
    explain_completions,
    makespans,
    policy_graph,
    precedence_arrays,
)
from twin.durations.bounded import Fixed, Uniform
from twin.durations.composed import SkillOverride
from twin.durations.lognormal import Lognormal
from twin.durations.measured import packaged_timings
from twin.durations.nanoseconds import Nanoseconds
from twin.engine.engine import Simulator
from twin.engine.execution_model import OTHER, ExecutionModel, Messages
from twin.engine.model_holds import with_model_holds
from twin.recorders.observers import MemoryRecorder
from twin.runs.execution_record import Policy
from twin.studies.replications.timing_graph import timing_graph
from twin.uncertainty.contraction import contract
from twin.uncertainty.disturbances import (
    Breakdowns,
    Disturbances,
    EmergencyStop,
    FixedFactor,
    Speed,
    Stalls,
)
from twin.uncertainty.node_times import NodeTimeSampler
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


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.booleans(), st.floats(5.0, 100.0))
def test_only_times_of_disturbed_robots_are_drawn_by_node(
    seed: int, driven: bool, mtbf_s: float
) -> None:
    """Equal to drawing all nodes of all robots, standstills included."""
    make = driven_tpg if driven else random_tpg
    tpg = make(seed, dofs=(2, 2, 2), edges=12)
    broken = Breakdowns(mtbf_s=mtbf_s, mttr_s=3.0, robots=(tpg.chains[1].robot,))
    model = ExecutionModel(DURATIONS, disturbances=Disturbances(breakdowns=broken))
    engine = BulkEngine(tpg, model, by_node=True)
    found = engine.sample(seed=seed, replications=range(4))
    free = with_full_speed_times(tpg)
    sampler = NodeTimeSampler(free, DURATIONS, model.disturbances)
    whole = sampler.sample_segments(
        engine.contraction, seed=seed, replications=range(4)
    )
    assert sampler.disturbed == [1]
    assert np.array_equal(found.busy_ns, whole.busy_ns)
    assert np.array_equal(found.stood_ns(), whole.stood_ns())
    few = BulkEngine(tpg, model)
    times = few.sample(seed=seed, replications=range(4))
    assert (times.rows is not None) == driven
    assert np.array_equal(few.makespans(times), engine.makespans(whole))


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
        policy,
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
    graph = policy_graph(tpg, policy)
    talk = Messages.of_seconds(depth, report, release).under(policy)
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


FOLDER = Path(__file__).parents[1] / "timing_graphs"
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


OF_MACHINES = SkillDurations(
    {"pick": Uniform(low_s=1.0, high_s=4.0), "place-down": Fixed(value_s=2.0)},
    (
        SkillOverride.model_construct(
            skill="arrive",
            robot="belt",
            object=None,
            duration=Uniform(low_s=2.0, high_s=30.0),
        ),
    ),
)


@pytest.fixture(scope="module")
def line() -> TemporalPlanGraph:
    plan, pattern = line_plan(every_s=16.0, leave_s=1.5, products=9, buffer=2)
    return splice_plans(copies_in_sequence(build_tpg(plan), pattern))


@pytest.mark.parametrize("policy", ["asynchronous", "sequential", "open-loop"])
@pytest.mark.parametrize(
    "disturbances",
    [Disturbances(), Disturbances(stalls=Stalls(count_per_robot=3))],
    ids=["calm", "stalls"],
)
def test_engines_agree_on_machines(
    line: TemporalPlanGraph, policy: Policy, disturbances: Disturbances
) -> None:
    model = ExecutionModel(OF_MACHINES, policy, disturbances=disturbances)
    found = assert_same_ends(line, model, 3, range(8))
    for r in range(8):
        watched = Simulator(line, model).run(
            seed=3, replication=r, recorders=[MemoryRecorder()]
        )
        assert watched.makespan_ns == found.makespan_ns[r]


def test_one_robot_works_at_a_time_and_machines_beside_it(
    line: TemporalPlanGraph,
) -> None:
    run = Simulator(line, ExecutionModel(OF_MACHINES, "sequential")).run(seed=0)
    machines = line.machine_chains()
    robots = [k for k in range(len(line.chains)) if k not in machines]
    spans = np.concatenate(
        [np.stack([run.start_ns[k], run.end_ns[k]], axis=1) for k in robots]
    )
    spans = spans[np.argsort(spans[:, 0], kind="stable")]
    assert np.all(spans[1:, 0] >= spans[:-1, 1])
    (belt,) = (k for k, c in enumerate(line.chains) if c.robot == "belt")
    # The belt goes on while a robot works, until what may wait on it is full.
    assert run.start_ns[belt][1] == run.end_ns[belt][0]


def test_nothing_disturbs_a_machine(line: TemporalPlanGraph) -> None:
    stops = (EmergencyStop(at_s=5.0, duration_s=100.0),)
    stalls = Stalls(rate_per_h=3600.0)
    model = ExecutionModel(
        OF_MACHINES, disturbances=Disturbances(emergency_stops=stops, stalls=stalls)
    )
    run = Simulator(line, model).run(seed=1)
    for k in line.machine_chains():
        assert run.stopped_ns(k, run.makespan_ns) == 0
        assert not np.any(run.stood_ns[k])


def test_machines_take_messages_too(line: TemporalPlanGraph) -> None:
    slow = Messages.of_seconds(report_s=0.1, release_s=0.1)
    model = ExecutionModel(OF_MACHINES, messages=slow)
    late = Simulator(line, model).run(seed=1).makespan_ns
    assert late > Simulator(line, ExecutionModel(OF_MACHINES)).run(seed=1).makespan_ns


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 3), LATENCIES, st.floats(0.1, 0.99))
def test_engines_hold_back_to_the_same_nanosecond(
    seed: int, windows: int, latency: float, hold: float
) -> None:
    tpg = windowed_tpg(seed, windows=windows)
    model = ExecutionModel(
        VARIED,
        messages=Messages.of_seconds(1 + seed % 3, latency, latency),
        disturbances=Disturbances(
            stalls=Stalls(count_per_robot=1, duration_s=(0.5, 3))
        ),
        hold=hold,
    )
    held = with_model_holds(tpg, model)
    assert_same_ends(held, model, seed, [0, 1, 2])
    if latency == 0.0:
        run = Simulator(held, model).run(seed=seed)
        busy = np.concatenate(run.duration_ns) + np.concatenate(run.stood_ns)
        start, end = plain_times(held, busy[:, None])
        assert np.array_equal(start, np.concatenate(run.start_ns))
        assert np.array_equal(end, np.concatenate(run.end_ns))
        seen, _ = watched(held, VARIED, seed=seed, disturbances=model.disturbances)
        assert np.array_equal(end, np.concatenate(seen.end_ns))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 3))
def test_engines_agree_where_robots_keep_to_limits(seed: int, windows: int) -> None:
    tpg = windowed_tpg(seed, windows=windows)
    driven = with_limits(tpg, np.random.default_rng(seed), lambda chain, _: chain)
    model = ExecutionModel(VARIED, hold=0.9)
    assert_same_ends(with_model_holds(driven, model), model, seed, [0, 1])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.floats(0, 20), st.floats(0.1, 20))
def test_every_run_ends_whatever_stops_it(
    seed: int, at_s: float, lasts_s: float
) -> None:
    tpg = windowed_tpg(seed, windows=3)
    stop = EmergencyStop(robot="robot_0", at_s=at_s, duration_s=lasts_s)
    model = ExecutionModel(
        VARIED, disturbances=Disturbances(emergency_stops=(stop,)), hold=0.95
    )
    run = Simulator(with_model_holds(tpg, model), model).run(seed=seed)
    assert run.outcome == "completed"


def test_nothing_is_held_back_where_nothing_asks_for_it() -> None:
    tpg = windowed_tpg(3)
    for model in (
        ExecutionModel(VARIED),
        ExecutionModel(VARIED, "sequential", hold=0.95),
    ):
        assert with_model_holds(tpg, model) is tpg
    assert (
        with_model_holds(
            replace(tpg, windows=()), ExecutionModel(VARIED, hold=0.9)
        ).windows
        == ()
    )


REPLICATIONS = 70


def completions(graph: PrecedenceArrays, busy: Nanoseconds) -> Completions:
    end = end_times(graph, busy)
    return explain_completions(graph, end - busy, end)


def _busy(seed: int, nodes: int, longest: int = 5) -> Nanoseconds:
    """Few different durations, so that ties and zeros are common."""
    rng = np.random.default_rng(seed)
    return rng.integers(0, longest, (nodes, REPLICATIONS)).astype(np.int64)


def _per_chain(tpg: TemporalPlanGraph, column: Nanoseconds) -> list[Nanoseconds]:
    cuts = np.cumsum([len(chain) for chain in tpg.chains])[:-1]
    return np.split(column, cuts)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 4))
def test_every_replication_is_a_longest_path(seed: int, robots: int) -> None:
    tpg = random_tpg(seed, dofs=(2,) * robots, edges=12 if robots > 1 else 0)
    busy = _busy(seed, sum(len(chain) for chain in tpg.chains))
    found = completions(precedence_arrays(tpg), busy)
    for r in range(0, REPLICATIONS, 23):
        oracle = earliest_times(tpg, _per_chain(tpg, busy[:, r]))
        assert np.array_equal(np.concatenate(oracle.end), found.end_ns[:, r])
        assert found.makespan_ns[r] == oracle.makespan
        for chain in range(robots):
            assert found.waited_ns[chain, :, r].sum() == (
                oracle.end[chain][-1] - oracle.duration[chain].sum()
            )


@pytest.mark.parametrize("contracted", [False, True])
def test_events_give_the_same_times(contracted: bool) -> None:
    tpg = random_tpg(5, dofs=(2, 3, 2), tasks=12, edges=15)
    durations = SkillDurations({"pick": Uniform(low_s=0.5, high_s=4.0)})
    simulator = Simulator(tpg, ExecutionModel(durations))
    runs = [simulator.run(seed=3, replication=r) for r in range(20)]
    busy = np.stack([np.concatenate(run.duration_ns) for run in runs], axis=1)
    if contracted:
        short = contract(tpg)
        columns = [_per_chain(tpg, busy[:, r]) for r in range(20)]
        sums = [np.concatenate(short.sums(column)) for column in columns]
        found = completions(precedence_arrays(short.tpg), np.stack(sums, axis=1))
    else:
        found = completions(precedence_arrays(tpg), busy)
        ends = np.stack([np.concatenate(run.end_ns) for run in runs], axis=1)
        assert np.array_equal(found.end_ns, ends)
    assert found.makespan_ns.tolist() == [run.makespan_ns for run in runs]
    waits = [[run.wait_ns(k) for run in runs] for k in range(3)]
    assert found.waited_ns.sum(axis=1).tolist() == waits


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_slack_is_what_a_node_can_take_and_no_more(seed: int) -> None:
    tpg = random_tpg(seed, dofs=(2, 2, 2), edges=12)
    graph = precedence_arrays(tpg)
    busy = _busy(seed, sum(len(chain) for chain in tpg.chains))[:, :1]
    found = completions(graph, busy)
    for node in range(0, len(busy), 3):
        for extra, later in ((0, 0), (1, 1)):
            longer = busy.copy()
            longer[node] += found.slack_ns[node] + extra
            grown = makespans(graph, end_times(graph, longer)) - found.makespan_ns
            assert grown.tolist() == [later]


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_a_critical_path_adds_up_to_the_makespan(seed: int) -> None:
    tpg = random_tpg(seed, dofs=(2, 3, 2), edges=14)
    busy = _busy(seed, sum(len(chain) for chain in tpg.chains))
    found = completions(precedence_arrays(tpg), busy)
    total = np.where(found.critical, busy, 0).sum(axis=0)
    assert np.array_equal(total, found.makespan_ns)
    assert not np.any(found.slack_ns[found.critical])
    assert found.slack_ns.min() >= 0


@pytest.mark.parametrize("driven", [False, True])
def test_slack_of_what_was_executed_counts_neither_messages_nor_braking(
    driven: bool,
) -> None:
    tpg = (driven_tpg if driven else random_tpg)(6, dofs=(2, 3, 2), tasks=12, edges=14)
    durations = SkillDurations({"pick": Uniform(low_s=0.5, high_s=4.0)})
    late = Messages.of_seconds(3, 0.3, 0.1)
    simulator = Simulator(tpg, ExecutionModel(durations, messages=late))
    runs = [simulator.run(seed=3, replication=r) for r in range(5)]
    start, end = (
        np.stack([np.concatenate(getattr(run, name)) for run in runs], axis=1)
        for name in ("start_ns", "end_ns")
    )
    found = explain_completions(precedence_arrays(tpg), start, end)
    assert found.waited_ns[:, OTHER].sum() > 0
    assert not np.any(found.slack_ns[found.critical])
    assert found.slack_ns.min() == 0 < found.slack_ns.max()


def test_a_wait_has_the_cause_of_the_edge_that_ended_it() -> None:
    tpg = random_tpg(2, dofs=(2, 2), tasks=8, edges=14)
    busy = _busy(2, sum(len(chain) for chain in tpg.chains), longest=10**6)
    for cause in (TASK_DEPENDENCY, MOTION_CONFLICT):
        one = replace(tpg, cause=np.full(len(tpg.edges), cause, dtype=np.uint8))
        found = completions(precedence_arrays(one), busy)
        assert found.waited_ns[:, cause].sum() > 0
        assert found.waited_ns[:, 1 - cause].sum() == 0
        assert found.waited_ns[:, OTHER].sum() == 0


def test_the_clock_holds_nodes_back() -> None:
    tpg = random_tpg(4, dofs=(2, 2), edges=0)
    nodes = sum(len(chain) for chain in tpg.chains)
    busy = _busy(4, nodes)
    late = np.arange(nodes, dtype=np.int64) * 7
    found = completions(precedence_arrays(tpg, late), busy)
    assert np.all(found.start_ns >= late[:, None])
    for r in (0, REPLICATIONS - 1):
        clock = 0
        for n in range(len(tpg.chains[0])):
            clock = max(clock, late[n]) + busy[n, r]
            assert found.end_ns[n, r] == clock
    assert found.waited_ns[:, :OTHER].sum() == 0
    still = found.chain_end_ns.sum() - busy.sum()
    assert found.waited_ns[:, OTHER].sum() == still > 0


def test_edges_can_be_traced_to_the_graph() -> None:
    tpg = random_tpg(7, dofs=(2, 2, 2), edges=14)
    graph = precedence_arrays(tpg)
    order = np.lexsort((tpg.edges[:, 3], tpg.edges[:, 2]))
    rows = tpg.edges[order]
    sources = graph.first[rows[:, 0]] + rows[:, 1]
    assert np.array_equal(graph.source, sources)
    assert np.array_equal(graph.cause, tpg.cause[order])
