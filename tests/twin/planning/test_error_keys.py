"""``cell.robots.base_error`` and ``planning.deviation``: read, refused where nothing plans with them, and kept."""

from pathlib import Path

import pytest

from planning.cell.workcell import NO_ERROR, PoseError
from scheduling.verification.verify import verify_plan
from tests.twin.scenarios.executed import built
from tests.twin.written import refusal, written
from twin.planning.build_workcell import build_workcell
from twin.reading.scenario_file import load_scenario
from twin.uncertainty.base_errors import PoseErrorSection

SCENARIOS = Path(__file__).parents[3] / "scenarios"
GOALS = (SCENARIOS / "multi_arm" / "multi_goal.yaml").read_text(encoding="utf-8")
CRANE = (SCENARIOS / "construction" / "handover.yaml").read_text(encoding="utf-8")
EAST = "model: panda, base: {xyz_m: [0.62, 0, 0]"


@pytest.mark.nightly
def test_all_is_planned_with_the_errors_that_are_given(tmp_path: Path) -> None:
    error = PoseError(0.002, 0.003)
    text = "base_error: {m: 0.002, rad: 0.003}"
    tpg = built(tmp_path, GOALS, (EAST, f"{text}, {EAST}")).tpg
    errors = {robot.name: robot.base_error for robot in tpg.cell.robots}
    assert errors.pop("east") == error
    assert set(errors.values()) == {NO_ERROR}
    survived = verify_plan(tpg, base_error=PoseError(4e-4, 5e-4)).survived
    assert survived is not None
    limiting = survived.robots.limiting
    assert limiting is not None
    # What is tight is between robots of which nothing was said.
    assert "east" not in {limiting.first.robot, limiting.second.robot}


@pytest.mark.parametrize(
    ("error", "words"),
    [
        ("{m: -0.001}", "base_error.m"),
        ("{rad: 1.0}", "base_error.rad"),
        ("{mm: 1}", "did you mean 'm'"),
        ("0.001", "base_error"),
    ],
)
def test_what_is_no_error_is_refused(tmp_path: Path, error: str, words: str) -> None:
    wrong = refusal(tmp_path, GOALS, (EAST, f"base_error: {error}, {EAST}"))
    assert words in str(wrong)


def test_constructions_have_none(tmp_path: Path) -> None:
    crane = "model: tower-crane,"
    wrong = refusal(tmp_path, CRANE, (crane, f"{crane} base_error: {{m: 0.001}},"))
    assert "base_error" in str(wrong)
    assert "leave it out" in str(wrong)


CLIFF = (SCENARIOS / "lego" / "cliff.yaml").read_text(encoding="utf-8")


def said(deviation: str) -> tuple[str, str]:
    return "seed: 0\n", f"seed: 0\nplanning:\n  deviation: {deviation}\n"


def test_the_cell_has_the_deviations_that_are_given(tmp_path: Path) -> None:
    own = "{place-down: {m: 0.001, rad: 0.002}, pick: {m: 0}}"
    scenario = load_scenario(written(tmp_path, CLIFF, said(own)))
    cell = build_workcell(scenario)
    assert cell.deviations == {"place-down": PoseError(0.001, 0.002)}
    # What a run draws is what planning says, unless it says another.
    disturbances = scenario.execution
    assert disturbances.deviations_in(cell) == cell.deviations
    other = disturbances.changed(deviation={"pick": PoseErrorSection(m=0.002)})
    assert other.deviations_in(cell) == {"pick": PoseError(0.002, 0.0)}


@pytest.mark.parametrize(
    ("deviation", "words"),
    [
        ("{place-down: {m: -0.001}}", "deviation.place-down.m"),
        ("{place-down: {mm: 1}}", "did you mean 'm'"),
        ("{place-dwn: {m: 0.001}}", "did you mean 'place-down'"),
        ("{m: 0.001}", "deviation.m"),
    ],
)
def test_what_is_no_deviation_is_refused(
    tmp_path: Path, deviation: str, words: str
) -> None:
    assert words in str(refusal(tmp_path, CLIFF, said(deviation)))


def test_constructions_have_no_deviation(tmp_path: Path) -> None:
    line = "planning: {deviation: {place-down: {m: 0.001}}}\n"
    wrong = refusal(tmp_path, CRANE, ("\nassembly:\n", f"\n{line}\nassembly:\n"))
    assert "without deviation: leave it out" in str(wrong)
