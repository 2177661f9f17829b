"""Skills that are drawn shorter than their joints allow are raised, alike in both engines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planning.tasks.task import SKILLS
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.one_draw import sample_node_times
from tests.twin.twin_toys import random_tpg
from twin.durations.bounded import Fixed
from twin.engine.bulk.bulk_engine import BulkEngine
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel
from twin.run.trajectory import robot_trajectories
from twin.study.replications.workload import timing_graph
from twin.uncertainty.disturbances import Disturbances, FixedFactor, Speed
from twin.uncertainty.skill_durations import SkillDurations, least_ns

QUICK = SkillDurations({kind: Fixed(value_s=1e-6) for kind in SKILLS})


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
        replace(chain, duration=2e-9 * own + 1e-9)
        for chain, own in zip(tpg.chains, least, strict=True)
    )
    tpg = replace(tpg, chains=chains)
    quick = Disturbances(speed=Speed(factor=FixedFactor(kind="fixed", value=10.0)))
    share = fastest(tpg, ExecutionModel(QUICK, disturbances=quick), skills=False)
    assert 0.99 < share <= 1.0
