"""Durations of many replications at once are those of one at a time, bit by bit."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.tasks.task import TaskKind
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.drawn_runs import sample, sample_node_times, uniform
from tests.twin.twin_toys import random_tpg, with_cut_skill
from twin.bulk.bulk_engine import BulkEngine
from twin.durations.bounded import Fixed, Uniform
from twin.durations.lognormal import Lognormal
from twin.durations.measured import MeasuredTimes
from twin.durations.model import DurationModel
from twin.durations.nanoseconds import to_nanoseconds
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel
from twin.runs.trajectory import robot_trajectories
from twin.studies.replications.timing_graph import timing_graph
from twin.uncertainty.disturbances import Disturbances, FixedFactor, Speed
from twin.uncertainty.least_durations import least_ns
from twin.uncertainty.skill_durations import SkillDurations, nominal_ns, share_duration

MODELS: dict[str, DurationModel] = {
    "pick": Lognormal(median_s=6.0, p95_s=8.0),
    "place-down": Uniform(low_s=3.0, high_s=5.0),
    "place-up": MeasuredTimes(values=(1.0, 2.0, 7.0)),
    "handover": Fixed(value_s=8.7),
    "support-top": Lognormal(median_s=4.0, p95_s=5.0),
}
"""All skills but one."""


@settings(deadline=None)
@given(
    st.integers(0, 50),
    st.integers(0, 2**40),
    st.lists(st.integers(0, 2**40), max_size=6),
    st.booleans(),
)
def test_bulk_equals_one_at_a_time(
    plan: int, seed: int, replications: list[int], antithetic: bool
) -> None:
    tpg = with_cut_skill(random_tpg(plan, tasks=12))
    durations = SkillDurations(MODELS, antithetic=antithetic)
    draws = durations.bind(tpg)
    totals = draws.totals(seed=seed, replications=replications)
    bulk = [draws.durations(k, totals) for k in range(len(tpg.chains))]
    tasks = draws.tasks
    assert totals.shape == (len(tasks), len(replications))
    for row, replication in enumerate(replications):
        one = sample(durations, tpg, seed=seed, replication=replication)
        sums = dict.fromkeys(tasks.tolist(), 0)
        for chain, many, alone in zip(tpg.chains, bulk, one, strict=True):
            assert many.dtype == alone.dtype == np.int64
            assert np.array_equal(many[:, row], alone)
            for node in np.flatnonzero(chain.skill):
                if chain.task[node] in sums:
                    sums[int(chain.task[node])] += int(alone[node])
        assert list(sums.values()) == totals[:, row].tolist()


def test_a_duration_follows_from_its_name() -> None:
    """The slow way: one named uniform a task, through the quantile function."""
    tpg = random_tpg(3, tasks=60)
    draws = SkillDurations(MODELS).bind(tpg)
    totals = draws.totals(seed=5, replications=range(7, 10))
    expected = [task for task in tpg.tasks if task.kind in MODELS]
    assert draws.tasks.tolist() == [task.index for task in expected]
    assert {task.kind for task in expected} == set(MODELS)
    for row, replication in enumerate(range(7, 10)):
        for total, task in zip(totals[:, row], expected, strict=True):
            u = uniform(5, replication, task.robot, task.index, task.kind, "duration")
            quantile = MODELS[task.kind].ppf(np.array([u]))
            assert total == to_nanoseconds(quantile)[0]


def test_antithetic_pairs_mirror_their_uniforms() -> None:
    tpg = random_tpg(3, tasks=20)
    models = {skill: Uniform(low_s=2.0, high_s=4.0) for skill in TaskKind.SKILLS}
    plain, paired = (
        SkillDurations(models, antithetic=antithetic)
        .bind(tpg)
        .totals(seed=5, replications=range(200))
        .T
        for antithetic in (False, True)
    )
    assert np.array_equal(paired[::2], plain[::2])
    assert np.all(np.abs(paired[::2] + paired[1::2] - 6_000_000_000) <= 1)
    assert not np.array_equal(plain[1::2], paired[1::2])


def test_antithetic_pairs_lower_the_variance_of_a_mean() -> None:
    tpg = random_tpg(3, tasks=20)
    models = {skill: Lognormal(median_s=6.0, p95_s=8.0) for skill in TaskKind.SKILLS}

    def variance_of_pair_means(antithetic: bool) -> float:
        durations = SkillDurations(models, antithetic=antithetic)
        totals = durations.bind(tpg).totals(seed=1, replications=range(4000))
        sums = totals.sum(axis=0) / 1e9
        return float(np.var(sums.reshape(-1, 2).mean(axis=1)))

    assert variance_of_pair_means(True) < 0.2 * variance_of_pair_means(False)


def test_nothing_to_draw_is_nothing_drawn() -> None:
    tpg = random_tpg(3, tasks=20)
    draws = SkillDurations({}).bind(tpg)
    assert draws.tasks.shape == (0,)
    totals = draws.totals(seed=1, replications=range(3))
    assert totals.shape == (0, 3)
    for k, nominal in enumerate(nominal_ns(tpg)):
        rows = draws.durations(k, totals)
        assert np.array_equal(rows, np.stack([nominal] * 3, axis=1))


@settings(deadline=None)
@given(
    st.lists(st.integers(0, 10**12), min_size=1, max_size=5),
    st.lists(st.floats(0, 1e3), min_size=1, max_size=6),
)
def test_shares_add_up_and_are_in_proportion(
    totals: list[int], weights: list[float]
) -> None:
    parts = share_duration(np.array(totals), np.array(weights))
    assert parts.shape == (len(weights), len(totals))
    assert parts.sum(axis=0).tolist() == totals
    assert parts.min() >= 0
    whole = sum(weights)
    for weight, row in zip(weights, parts, strict=True):
        share = weight / whole if whole > 0 else 1 / len(weights)
        assert row == pytest.approx(share * np.array(totals), abs=1.5, rel=1e-9)


QUICK = SkillDurations({kind: Fixed(value_s=1e-6) for kind in TaskKind.SKILLS})


def planned(seed: int) -> TemporalPlanGraph:
    return random_tpg(seed, dofs=(2, 3), tasks=6, nodes_per_transit=3, edges=8)


def fastest(tpg: TemporalPlanGraph, model: ExecutionModel, skills: bool) -> float:
    """Oracle: the greatest share of a speed limit between two rows of a trajectory."""
    run = Simulator(tpg, model).run(seed=0)
    out = 0.0
    for chain, rows in zip(tpg.chains, robot_trajectories(tpg, run), strict=True):
        speed = tpg.cell.robot(chain.robot).model.velocity
        seconds = np.diff(rows.t_ns) / 1e9 + 2e-9
        share = np.abs(np.diff(rows.q, axis=0)) / speed / seconds[:, None]
        of_skill = chain.skill[np.maximum(rows.node[1:], 0)] == skills
        out = max(out, float(share[of_skill].max(initial=0.0)))
    return out


def test_skills_run_at_their_limits_at_most_in_both_engines() -> None:
    for seed in range(5):
        tpg = planned(seed)
        model = ExecutionModel(QUICK)
        run = Simulator(tpg, model).run(seed=0)
        skills = sum(len(np.unique(chain.task[chain.skill])) for chain in tpg.chains)
        assert 0 < run.raised_skills <= skills
        assert 0.99 < fastest(tpg, model, skills=True) <= 1.0
        bulk = BulkEngine(tpg, model)
        segments = bulk.sample(seed=0, replications=[0]).busy_ns[:, 0]
        assert segments.sum() == sum(int(own.sum()) for own in run.duration_ns)
        assert bulk.least_makespan_ns() <= run.makespan_ns


def test_graphs_without_paths_know_how_quick_they_can_be() -> None:
    for seed in range(5):
        tpg = planned(seed)
        bare = timing_graph(tpg)
        assert not bare.cell.robots
        for own, kept in zip(least_ns(tpg), least_ns(bare), strict=True):
            assert own.tolist() == kept.tolist()
        model = ExecutionModel(QUICK)
        run, again = (Simulator(graph, model).run(seed=0) for graph in (tpg, bare))
        assert again.makespan_ns == run.makespan_ns
        assert again.raised_skills == run.raised_skills > 0
        bulk = [BulkEngine(graph, model) for graph in (tpg, timing_graph(bare))]
        times = [b.sample(seed=0, replications=range(3)).busy_ns for b in bulk]
        assert times[0].tolist() == times[1].tolist()


def test_what_is_slow_enough_is_left_alone() -> None:
    slow = SkillDurations({kind: Fixed(value_s=900.0) for kind in QUICK.models})
    times = sample_node_times(planned(1), slow, seed=0)
    assert times.raised == 0


def test_transits_drawn_quicker_keep_to_their_limits() -> None:
    """A plan at half the limits, at ten times its speed."""
    tpg = planned(2)
    least = least_ns(tpg)
    chains = tuple(
        replace(chain, duration=np.asarray(2e-9 * own + 1e-9, dtype=float))
        for chain, own in zip(tpg.chains, least, strict=True)
    )
    tpg = replace(tpg, chains=chains)
    quick = Disturbances(speed=Speed(factor=FixedFactor(kind="fixed", value=10.0)))
    share = fastest(tpg, ExecutionModel(QUICK, disturbances=quick), skills=False)
    assert 0.99 < share <= 1.0
