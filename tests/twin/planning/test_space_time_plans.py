"""Space-time plans all the way: motion plan, graph, proof, execution under delays, audit."""

from collections.abc import Callable
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.construction.checks.checker import SpaceTimeChecker
from planning.construction.motion_plan_export import export_motion_plan, motion_plan
from planning.construction.planner import ConstructionPlan
from planning.construction.world.fixed_world import FixedWorld, PlannedTask
from planning.errors import PlanInvariantError
from planning.motion.motion_plan import MotionPlan
from planning.tasks.task import TaskKind
from scheduling.build_tpg import build_tpg
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.verify import verify_plan
from tests.planning.construction.toy_sites import handover_plan, tower_plan
from tests.planning.construction.toy_tasks import PLAIN, find_path, with_task, world_of
from tests.planning.construction.toy_teams import placed, slider, team
from twin.audits.audit import Auditor
from twin.audits.motion.executed import read_recording
from twin.durations.bounded import Uniform
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel
from twin.recorders.run_tables import objects_table, trajectory_table, write_table
from twin.runs.folder import OBJECTS, TRAJECTORY
from twin.runs.trajectory import object_placements, robot_trajectories
from twin.uncertainty.disturbances import Disturbances, Stalls
from twin.uncertainty.skill_durations import SkillDurations

QUICK = PLAIN._replace(iterations=300, patience=50, rounds=1, checks=0, shortcuts=10)


def crossing(count: int, seed: int) -> tuple[FixedWorld, list[PlannedTask]]:
    """Sliders on a circle change places, some twice, each planned among those before it."""
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * np.arange(count) / count
    cell = team(
        [
            placed(f"s{k}", slider(), (1.1 * np.cos(a), 1.1 * np.sin(a)))
            for k, a in enumerate(angle)
        ]
    )
    world, tasks = FixedWorld(cell), []
    for _ in range(count + 2):
        robot = f"s{rng.integers(count)}"
        checker = SpaceTimeChecker(world, robot)
        goals = rng.uniform(-1.2, 1.2, (4, 2))
        found = find_path(checker, goals, QUICK, stay=np.inf, seed=seed)
        if found is None:
            continue
        task = PlannedTask(
            robot, TaskKind.TRANSIT, found.time, found.path, 1, f"{robot} goes"
        )
        world = with_task(world, task)
        tasks.append(task)
    return world, tasks


@settings(max_examples=3, deadline=None)
@given(st.integers(0, 1000))
def test_robots_that_cross_keep_their_times_and_every_guarantee(seed: int) -> None:
    world, tasks = crossing(3 + seed % 3, seed)
    plan = export_motion_plan(world, tasks)
    tpg = build_tpg(plan)
    assert verify_plan(tpg).ok
    # Waits may shrink, nothing comes later than planned.
    assert earliest_times(tpg).makespan <= max(m.time[-1] for m in plan.motions) + 1e-6
    for task, motion in zip(plan.tasks, plan.motions, strict=True):
        line = world.robots[task.robot]
        for q, t in zip(motion.path, motion.time, strict=True):
            assert np.allclose(q, line.at(float(t)), atol=1e-9)


@cache
def planned(
    make: Callable[[], ConstructionPlan],
) -> tuple[MotionPlan, TemporalPlanGraph]:
    plan = make()
    motions = motion_plan(plan.problem, plan.building)
    return motions, build_tpg(motions)


both = pytest.mark.parametrize("make", [tower_plan, handover_plan])


@both
def test_a_construction_is_proved_safe_and_no_slower_than_planned(
    make: Callable[[], ConstructionPlan],
) -> None:
    plan, tpg = planned(make)
    report = verify_plan(tpg)
    assert report.ok, report.problems
    planned_s = max(m.time[-1] for m in plan.motions)
    assert earliest_times(tpg).makespan <= planned_s + 1e-6
    if make is handover_plan:
        kinds = {t.kind for t in plan.tasks}
        assert kinds == {TaskKind.TRANSIT, "pick", "place-down", "handover"}
        return
    # They do work at the same time.
    busy = sum(float(m.time[-1] - m.time[0]) for m in plan.motions)
    assert busy > 1.3 * planned_s
    places = [t.index for t in plan.tasks if t.kind == "place-down"]
    edges = {tuple(e) for e in plan.dependencies.tolist()}
    assert {(a, b) for a, b in pairwise(places)} <= edges


@pytest.mark.nightly
@both
def test_nothing_touches_whatever_is_delayed(
    make: Callable[[], ConstructionPlan], tmp_path: Path
) -> None:
    _, tpg = planned(make)
    skills = ("pick", "place-down", "handover")
    varied = SkillDurations({skill: Uniform(low_s=0.3, high_s=4.0) for skill in skills})
    stalls = Disturbances(stalls=Stalls(count_per_robot=4, duration_s=(1.0, 10.0)))
    with Auditor(tpg) as auditor:
        for seed in range(3):
            simulator = Simulator(tpg, ExecutionModel(SkillDurations({})))
            if seed:
                simulator = Simulator(tpg, ExecutionModel(varied, disturbances=stalls))
            run = simulator.run(seed=seed)
            assert run.outcome == "completed"
            motions = robot_trajectories(tpg, run)
            write_table(tmp_path / TRAJECTORY, trajectory_table(motions))
            placements = object_placements(tpg, run)
            write_table(tmp_path / OBJECTS, objects_table(placements))
            found = auditor.audit(read_recording(tmp_path, tpg.cell))
            assert found.violations == ()
            assert found.configurations > 1000


def test_a_plan_in_which_robots_meet_is_refused_by_name() -> None:
    cell = team(
        [placed("a", slider(), (-1.0, 0.0)), placed("b", slider(), (0.0, -1.0))]
    )
    tasks = [
        PlannedTask(
            "a",
            TaskKind.TRANSIT,
            np.array([0.0, 4.0]),
            np.array([[-1.0, 0], [1, 0]]),
            1,
            "east",
        ),
        PlannedTask(
            "b",
            TaskKind.TRANSIT,
            np.array([0.0, 4.0]),
            np.array([[0.0, -1], [0, 1]]),
            1,
            "north",
        ),
    ]
    with pytest.raises(PlanInvariantError, match=r"'b' \(north.*'a' \(east.*too close"):
        export_motion_plan(world_of(cell, tasks), tasks)


def test_close_robots_get_finer_nodes_than_distant_ones() -> None:
    def nodes(gap: float) -> int:
        cell = team(
            [
                placed("a", slider(), (-1.0, 0.0)),
                placed("b", slider(), (-1.0 - gap, 0.0)),
            ]
        )
        tasks = [
            PlannedTask(
                name,
                TaskKind.TRANSIT,
                np.array([0.0, 4.0]),
                np.array([[x, 0.0], [x + 2.0, 0.0]]),
                1,
                name,
            )
            for name, x in (("a", -1.0), ("b", -1.0 - gap))
        ]
        plan = export_motion_plan(world_of(cell, tasks), tasks)
        assert verify_plan(build_tpg(plan)).ok
        return sum(len(motion.path) - 1 for motion in plan.motions)

    assert nodes(1.0) == 80
    assert nodes(0.33) > 80
