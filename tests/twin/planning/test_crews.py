"""Crews: plans rated exactly, and no step for a robot that only stands in the way of the others."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import twin.trial.planning as planning
from planning.motion.motion_plan import MotionPlan
from planning.tasks.assembly import Assembly
from planning.tasks.assignment import (
    AssignmentProblem,
    PrimaryCandidate,
    TaskPlan,
    alternative_choices,
)
from scheduling.ordering.plan_rating import PlanRater
from scheduling.ordering.robot_subsets import robot_subsets
from scheduling.planned_motions import PlannedMotions
from scheduling.verification.verify import verify_plan
from tests.twin.planning.facing_arms import FACING_ARMS
from tests.twin.scenarios.cells import GP4S, cell
from tests.twin.written import loaded
from twin.host.progress import StageWatch
from twin.planning.pipeline import plan_motions
from twin.scenario.sections.scenario import Scenario
from twin.trial.plan_result import PlanResult
from twin.trial.planning import chooses_robot_subset, plan_scenario

SCENARIO = (
    FACING_ARMS
    + """\
  stock:
    - {name: left_a, brick: 2x4, at: [2, 30, 1]}
    - {name: left_b, brick: 2x4, at: [6, 30, 1]}
    - {name: left_c, brick: 2x4, at: [6, 20, 1]}
    - {name: right_a, brick: 2x4, at: [44, 30, 1]}
    - {name: right_b, brick: 2x4, at: [40, 30, 1]}
    - {name: right_c, brick: 2x4, at: [40, 20, 1]}
  steps:
    - {brick: 2x4, at: [23, 15, 1]}
    - {brick: 2x4, at: [23, 25, 1]}
    - {brick: 2x4, at: [23, 15, 2]}
    - {brick: 2x4, at: [23, 25, 2]}
"""
)

PARTS = cell(
    "parts",
    GP4S,
    """\
  kind: assembly
  parts:
    - {name: a, size_m: [0.0158, 0.0318, 0.0096], start: {xyz_m: [0.34, 0.12, 1.1193]}, goal: {xyz_m: [0.42, 0, 1.1193]}}
    - {name: b, size_m: [0.0158, 0.0318, 0.0096], start: {xyz_m: [0.54, 0.12, 1.1193]}, goal: {xyz_m: [0.46, 0, 1.1193]}}
    - {name: c, size_m: [0.0158, 0.0318, 0.0096], start: {xyz_m: [0.34, -0.12, 1.1193]}, goal: {xyz_m: [0.42, 0, 1.1289]}}
    - {name: d, size_m: [0.0158, 0.0318, 0.0096], start: {xyz_m: [0.54, -0.12, 1.1193]}, goal: {xyz_m: [0.46, 0, 1.1289]}}
  steps: [a, b, c, d]
""",
    "{name: plate, size_m: [0.384, 0.384, 0.005], pose: {xyz_m: [0.44, 0, 1.112]}}",
)


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    return _changed(
        loaded(tmp_path_factory.mktemp("four"), SCENARIO), shortcut_candidates=60
    )


@pytest.fixture(scope="module")
def first(scenario: Scenario) -> PlannedMotions:
    return plan_motions(scenario, Path(), StageWatch())


@pytest.fixture(scope="module")
def plain(scenario: Scenario) -> PlanResult:
    """Return the plan that nothing improves."""
    return plan_scenario(scenario, bound=True)


def _rater(first: PlannedMotions, *, shortcuts: bool) -> PlanRater:
    return PlanRater(first.cell, first.settings, shortcuts=shortcuts)


def _changed(scenario: Scenario, **keys: object) -> Scenario:
    planning = scenario.planning.model_copy(update=keys)
    return scenario.model_copy(update={"planning": planning})


def _work(first: PlannedMotions) -> Assembly:
    assert first.work is not None
    return first.work


def _walk(work: Assembly, plan: TaskPlan, steps: int) -> list[TaskPlan]:
    """Return plans, each with another choice at one step of the one before."""
    rng = np.random.default_rng(5)
    plans: list[TaskPlan] = []
    while len(plans) < steps:
        step = 1 + int(rng.integers(len(plan.choices)))
        others = alternative_choices(work.problem, plan, step)
        if others:
            plan = plan.with_choice(others[int(rng.integers(len(others)))])
            plans.append(plan)
    return plans


def _same_motions(a: MotionPlan, b: MotionPlan) -> None:
    assert [task.label for task in a.tasks] == [task.label for task in b.tasks]
    assert a.allowed == b.allowed
    for one, other in zip(a.motions, b.motions, strict=True):
        assert np.array_equal(one.path, other.path)
        assert np.array_equal(one.time, other.time)


def _obeys(problem: AssignmentProblem, plan: TaskPlan) -> bool:
    """Tell whether a plan keeps (2) to (6) and what stands on what in the stock."""
    used: list[str] = []
    for choice in plan.choices:
        if choice.primary not in problem.primaries:
            return False
        if not choice.primary.after <= set(used):
            return False
        if (choice.support is None) is problem.needs_support[choice.step - 1]:
            return False
        used.append(choice.object)
    single = [name for name in used if name not in problem.unlimited]
    return len(single) == len(set(single))


def test_what_is_known_of_other_plans_changes_no_rating(first: PlannedMotions) -> None:
    _rate_as_fresh(first)


@pytest.mark.nightly
def test_what_is_known_of_other_plans_of_parts_changes_no_rating(
    tmp_path: Path,
) -> None:
    _rate_as_fresh(plan_motions(loaded(tmp_path, PARTS), tmp_path, StageWatch()))


def _rate_as_fresh(first: PlannedMotions) -> None:
    """Compare ratings by a rater that knows other plans with those by a fresh one."""
    once, twice = (_rater(first, shortcuts=on) for on in (False, True))
    work = _work(first)
    for plan in _walk(work, first.task_plan, 5):
        assert _obeys(work.problem, plan)
        for rater, shortcuts in ((once, False), (twice, True)):
            fresh = _rater(first, shortcuts=shortcuts).rate(work, plan)
            known = rater.rate(work, plan)
            assert (fresh is None) == (known is None)
            if fresh is None or known is None:
                continue
            assert known.by_home_s == fresh.by_home_s
            assert known.makespan_s == fresh.makespan_s
            _same_motions(known.motion_plan, fresh.motion_plan)
            if not shortcuts:
                # The graph built from scratch says what the search among orders said.
                assert known.makespan_s == pytest.approx(known.by_home_s, abs=1e-6)


def test_no_plan_is_below_the_bound_of_the_makespan(
    plain: PlanResult, first: PlannedMotions
) -> None:
    assert plain.makespan_bound_s is not None
    assert 0.0 < plain.makespan_bound_s <= plain.makespan_s
    rater = _rater(first, shortcuts=True)
    for plan in _walk(_work(first), first.task_plan, 4):
        rated = rater.rate(_work(first), plan)
        assert rated is None or plain.makespan_bound_s <= rated.makespan_s


BASES = {
    "left": "xyz_m: [0, 0, 0.9246]",
    "right": "xyz_m: [0.88, 0, 0.9246], rpy_deg: [0, 0, 180]",
    "front": "xyz_m: [0.44, -0.44, 0.9246], rpy_deg: [0, 0, 90]",
    "back": "xyz_m: [0.44, 0.44, 0.9246], rpy_deg: [0, 0, -90]",
}

PILE = """\
  kind: lego
  plate: {pose: {xyz_m: [0.44, 0, 1.1145]}, studs: [48, 48]}
  stock:
    - {name: a, brick: 2x4, at: [2, 30, 1]}
    - {name: b, brick: 2x4, at: [44, 30, 1]}
    - {name: c, brick: 2x4, at: [6, 30, 1]}
    - {name: d, brick: 2x4, at: [40, 30, 1]}
    - {name: e, brick: 2x4, at: [6, 36, 1]}
  steps:
    - {brick: 2x4, at: [23, 22, 1]}
    - {brick: 2x4, at: [23, 22, 2]}
    - {brick: 2x4, at: [23, 22, 3]}
    - {brick: 2x4, at: [23, 22, 4]}
planning: {shortcut_candidates: 0, assignment: paper}
"""


def _planned(folder: Path, arms: int) -> PlanResult:
    """Return the plan of a pile of four bricks, each on the one before, by so many arms."""
    robots = tuple(
        f"{{name: {name}, model: gp4, base: {{{BASES[name]}}}}}"
        for name in list(BASES)[:arms]
    )
    table = "{name: table, size_m: [0.6, 0.6, 0.02], pose: {xyz_m: [0.44, 0, 1.1045]}}"
    return plan_scenario(loaded(folder, cell("pile", robots, PILE, table)))


@pytest.mark.nightly
def test_one_more_arm_never_makes_a_plan_longer(tmp_path: Path) -> None:
    two, three, four = (_planned(tmp_path, arms) for arms in (2, 3, 4))
    assert three.makespan_s <= two.makespan_s + 1e-6
    assert four.makespan_s <= three.makespan_s + 1e-6
    assert verify_plan(four.tpg).ok


def test_an_arm_in_the_way_of_two_gets_no_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen = _planned(tmp_path, 3)
    monkeypatch.setattr(planning, "chooses_robot_subset", lambda _: False)
    two, shared = _planned(tmp_path, 2), _planned(tmp_path, 3)
    assert "front" in _shares(shared)
    assert shared.makespan_s > two.makespan_s
    assert _shares(chosen) == _shares(two)
    assert [chain.robot for chain in chosen.tpg.chains] == ["left", "right"]
    assert "front" in {robot.name for robot in chosen.tpg.cell.robots}


def _shares(plan: PlanResult) -> Counter[str]:
    return Counter(choice.robot for choice in plan.motions.task_plan.choices)


def test_two_arms_are_planned_as_they_were(tmp_path: Path) -> None:
    assert not chooses_robot_subset(_planned(tmp_path, 2).scenario.sections)
    assert chooses_robot_subset(_planned(tmp_path, 3).scenario.sections)


def test_crews_are_those_who_can_do_something_and_not_too_many() -> None:
    def problem(able: int) -> AssignmentProblem:
        ways = tuple(PrimaryCandidate(1, f"r{k}", "o", 0, 1.0) for k in range(able))
        names = (*(way.robot for way in ways), "idle")
        return AssignmentProblem(names, ("step",), (False,), ways)

    assert list(robot_subsets(problem(2))) == []
    assert list(robot_subsets(problem(3))) == [("r0", "r1"), ("r0", "r2"), ("r1", "r2")]
    assert len(list(robot_subsets(problem(5)))) == 5 + 10 + 10
    assert [len(crew) for crew in robot_subsets(problem(12))] == [11] * 12 + [10] * 20
