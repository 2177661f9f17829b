"""More than two robots: whoever only stands in the way of the others gets nothing to do."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

import twin.trial.planning as planning
from planning.tasks.assignment import AssignmentProblem, PrimaryCandidate
from scheduling.ordering.crews import crews
from scheduling.verification.verify import verify_plan
from tests.twin.scenarios.cells import cell
from tests.twin.written import loaded
from twin.trial.plan_result import PlanResult
from twin.trial.planning import chooses_crew, plan_scenario

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
planning: {shortcut_candidates: 0}
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
    monkeypatch.setattr(planning, "chooses_crew", lambda _: False)
    two, shared = _planned(tmp_path, 2), _planned(tmp_path, 3)
    assert "front" in _shares(shared)
    assert shared.makespan_s > two.makespan_s
    assert _shares(chosen) == _shares(two)
    assert [chain.robot for chain in chosen.tpg.chains] == ["left", "right"]
    assert "front" in {robot.name for robot in chosen.tpg.cell.robots}


def _shares(plan: PlanResult) -> Counter[str]:
    return Counter(choice.robot for choice in plan.motions.task_plan.choices)


def test_two_arms_are_planned_as_they_were(tmp_path: Path) -> None:
    assert not chooses_crew(_planned(tmp_path, 2).scenario.sections)
    assert chooses_crew(_planned(tmp_path, 3).scenario.sections)


def test_crews_are_those_who_can_do_something_and_not_too_many() -> None:
    def problem(able: int) -> AssignmentProblem:
        ways = tuple(PrimaryCandidate(1, f"r{k}", "o", 0, 1.0) for k in range(able))
        names = (*(way.robot for way in ways), "idle")
        return AssignmentProblem(names, ("step",), (False,), ways)

    assert list(crews(problem(2))) == []
    assert list(crews(problem(3))) == [("r0", "r1"), ("r0", "r2"), ("r1", "r2")]
    assert len(list(crews(problem(5)))) == 5 + 10 + 10
    assert [len(crew) for crew in crews(problem(12))] == [11] * 12 + [10] * 20
