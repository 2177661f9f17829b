"""Plans for skills that may deviate from their reference paths: planned with, proved, named."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from planning.cell.workcell import PoseError
from planning.errors import PlanInvariantError
from planning.motion.known_motions import MotionPlan
from scheduling.build_tpg import build_nodes, build_tpg
from scheduling.conflicts.derived_tpg import DerivedTpg, nodes_stretch
from scheduling.graph.plan_files import load_plan, plan_sha256, save_plan
from scheduling.invariant import check_invariant
from scheduling.verification.reference import ReferenceRobot, measure
from scheduling.verification.verify import verify_plan
from tests.scheduling import two_arms as world
from tests.scheduling.two_arms import Writer

ERROR = PoseError(0.001, 0.002)


def with_skills(plan: MotionPlan, every: int = 1) -> MotionPlan:
    """The same with motions that are skills, of one node each."""
    tasks = tuple(
        replace(task, kind="press", path=motion.path[1:])
        if task.index % every == 0
        else task
        for task, motion in zip(plan.tasks, plan.motions, strict=True)
    )
    return replace(plan, tasks=tasks)


def deviating(plan: MotionPlan, error: PoseError = ERROR) -> MotionPlan:
    return replace(plan, cell=replace(plan.cell, deviations={"press": error}))


@pytest.mark.parametrize("seed", range(3))
def test_a_plan_made_with_a_deviation_survives_it(seed: int) -> None:
    """By the proof's own code; and links that do not deviate are asked for no more."""
    plan = with_skills(world.random_turns(seed, 4, gap=0.64), every=2)
    tpg = build_tpg(deviating(plan))
    assert any(chain.skill.any() for chain in tpg.chains)
    check_invariant(DerivedTpg(tpg))
    report = verify_plan(tpg, deviation=ERROR)
    assert report.ok, report.problems
    assert report.survived is None
    assert report.deviated is not None
    assert report.deviated.ok


@cache
def meeting() -> tuple[MotionPlan, float]:
    """Right leans in and stands; left comes down beside it in a skill, less than 2 mm away."""
    cell = world.two_arms(gap=0.7)
    home = cell.robots[0].home
    robots = {r.name: ReferenceRobot(r) for r in cell.robots}
    lean = np.array([0, 1, 0.4, 0, 0, 0])

    def gap(share: float) -> float:
        q = home + share * lean
        parts = [
            [
                (p, r.joint_frame(q, p.joint) if p.joint >= 0 else r.base)
                for p in r.parts
            ]
            for r in (robots["left"], robots["right"])
        ]
        return min(measure(*a, *b) for a, b in product(*parts))

    near, far = 0.6, 0.0
    for _ in range(40):
        middle = 0.5 * (near + far)
        near, far = (near, middle) if gap(middle) > 0.0018 else (middle, far)
    writer = Writer(cell)
    writer.move("right", home + far * lean)
    writer.move("left", home + far * lean)
    writer.move("left", home)
    writer.move("right", home)
    plan = writer.plan()
    tasks = list(plan.tasks)
    for k in (1, 2):
        tasks[k] = replace(tasks[k], kind="press", path=plan.motions[k].path[1:])
    return replace(plan, tasks=tuple(tasks)), gap(far)


def test_two_skills_that_come_too_near_are_named() -> None:
    plan, gap = meeting()
    tpg = build_tpg(plan)
    assert verify_plan(tpg).ok
    report = verify_plan(tpg, deviation=PoseError(0.004, 0.004))
    survived = report.deviated
    assert survived is not None
    assert not report.ok
    assert not report.problems
    limiting = survived.robots.limiting
    assert limiting is not None
    assert {limiting.first.robot, limiting.second.robot} == {"left", "right"}
    assert limiting.first.task in (1, 2) or limiting.second.task in (1, 2)
    assert limiting.distance_m == pytest.approx(gap, abs=2e-4)
    assert survived.least is survived.robots
    # In the cell that says so it is a matter of the clearance, and cannot be planned either.
    wide = deviating(plan, PoseError(0.004, 0.004))
    assert not verify_plan(replace(tpg, cell=wide.cell)).ok
    with pytest.raises(PlanInvariantError):
        check_invariant(DerivedTpg(build_tpg(wide)))


def test_what_is_no_skill_does_not_deviate() -> None:
    plan = world.random_turns(0, 4, gap=0.64)
    tpg = build_tpg(plan)
    large = verify_plan(tpg, deviation=PoseError(0.05, 0.05))
    assert large.ok
    assert large.deviated is not None
    assert large.deviated.robots.limiting is None
    same = build_tpg(deviating(plan, PoseError(0.05, 0.05)))
    assert np.array_equal(same.edges, tpg.edges)


def test_deviating_nodes_are_other_stretches() -> None:
    """What is remembered of nodes that follow their path does not hold of those that do not."""
    plan = with_skills(world.random_turns(0, 2))
    plain, wide = (DerivedTpg(build_nodes(p)) for p in (plan, deviating(plan)))
    count = len(plain.tpg.chains[0])
    one, other = (nodes_stretch(g, 0, 0, count) for g in (plain, wide))
    assert one.content != other.content
    assert not one.occupancy.hulls.deviates.any()
    assert other.occupancy.hulls.deviates.any()


def test_deviations_come_back_with_a_plan(tmp_path: Path) -> None:
    plain = build_tpg(with_skills(world.random_turns(1, 2)))
    wide = replace(plain, cell=replace(plain.cell, deviations={"press": ERROR}))
    assert plan_sha256(wide) != plan_sha256(plain)
    none = replace(plain, cell=replace(plain.cell, deviations={}))
    assert plan_sha256(none) == plan_sha256(plain)
    save_plan(wide, tmp_path)
    again = load_plan(tmp_path)
    assert again.cell.deviations == {"press": ERROR}
    assert plan_sha256(again) == plan_sha256(wide)
