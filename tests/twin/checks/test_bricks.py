"""What the audit finds of grips and places of bricks, the check says before planning."""

from pathlib import Path

import numpy as np
import pytest

from planning.robots.registry import robot_model
from planning.transforms import translation
from tests.twin.written import Change, written
from twin.checks.check import check_scenario
from twin.checks.finding import CheckContext
from twin.document.validation import InvalidScenarioError
from twin.kinds.lego.checks import check_brick_tools
from twin.reading.scenario_file import load_scenario, read_scenario
from twin.scenario.sections.scenario import Scenario
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.plan_result import given_plan
from twin.trial.planning import plan_scenario
from twin.trial.run_plan import run_plan_to_folder

CLIFF = (Path(__file__).parents[3] / "scenarios/lego/cliff.yaml").read_text()


def frames(by_m: float, *moved: str) -> tuple[Change, ...]:
    """Return changes that let tool frames of both arms stand out by more."""
    model = robot_model("gp4")
    entries = []
    for name, pose in model.frames.items():
        far = by_m if name in moved or not moved else 0.0
        xyz = (pose @ translation(0.0, 0.0, far))[:3, 3]
        turns = np.degrees(np.arctan2(pose[1, 0], pose[0, 0]))
        assert np.allclose(pose[:3, 2], (0.0, 0.0, 1.0))
        place = ", ".join(f"{value:.9g}" for value in xyz)
        entries.append(f"{name}: {{xyz_m: [{place}], rpy_deg: [0, 0, {turns:.9g}]}}")
    own = f"      model: gp4\n      frames: {{{', '.join(entries)}}}\n"
    return (("      model: gp4\n", own),)


TABLE: dict[str, tuple[str, tuple[Change, ...], str]] = {
    "held away from the tool": ("grip", frames(0.009), "would hold a"),
    "held away on the side studs": ("grip", frames(0.014, "alt"), "would hold on its side studs a"),
    "a support in the air": ("support", frames(0.004), "would support a"),
    "a tool in what it holds": ("contact", frames(-0.004), "in it, by its frame 'tool'"),
    "a brick in a brick": ("contact", (("at: [23, 15, 2]", "at: [23, 14, 1]"),), "goes where step 1 already is"),
    "a brick in the plate": ("place", (("at: [23, 14, 1]", "at: [23, 14, 0]"),), "is below the plate"),
    "a brick beside the plate": ("place", (("at: [23, 14, 1]", "at: [47, 14, 1]"),), "is beyond the plate"),
    "a brick in the air": ("hanging", (("at: [23, 15, 2]", "at: [23, 15, 4]"),), "would float"),
}  # fmt: skip
"""By what is wrong: the kind of violation that the audit would find, how it is done, and what the check says."""


def test_all_kinds_of_violations_of_grips_and_places_are_in_the_table() -> None:
    """Kinds ``tool``, ``process`` and ``balance`` are of parts alone, ``jump`` of what was executed."""
    assert {kind for kind, _, _ in TABLE.values()} == {
        *("grip", "support", "contact", "place", "hanging")
    }


@pytest.mark.parametrize("what", TABLE)
def test_it_is_said_before_planning(what: str, tmp_path: Path) -> None:
    _, changes, says = TABLE[what]
    file = written(tmp_path, CLIFF, *changes)
    try:
        report = check_scenario(*read_scenario(file), tmp_path)
        found = [item.message for item in report.errors]
    except InvalidScenarioError as error:
        found = [problem.message for problem in error.problems]
    assert any(says in message for message in found), found


@pytest.mark.parametrize("by_m", [-0.002, 0.0, 0.0009])
def test_frames_at_the_tool_get_no_word(by_m: float, tmp_path: Path) -> None:
    scenario = load_scenario(written(tmp_path, CLIFF, *frames(by_m)))
    assert list(check_brick_tools(CheckContext(scenario, tmp_path))) == []


@pytest.mark.nightly
def test_the_distances_are_those_that_the_audit_measures(tmp_path: Path) -> None:
    """Oracle: the audit of an execution, planned in spite of what the check says."""
    scenario: Scenario = load_scenario(written(tmp_path, CLIFF, *frames(0.0107)))
    found = [
        item.message
        for item in check_brick_tools(CheckContext(scenario, tmp_path))
        if "left would hold a" in item.message
    ]
    planned = plan_scenario(scenario, tmp_path)
    (tmp_path / "run").mkdir()
    trial = run_plan_to_folder(
        given_plan(LoadedScenario(scenario, tmp_path), planned.tpg), tmp_path / "run"
    )
    grips = [
        own["depth_m"]
        for own in trial.summary["audit"]["violations"]
        if own["kind"] == "grip" and own["second"] == "left"
    ]
    assert grips != []
    assert any(f"{1e3 * max(grips):.1f} mm away from it" in words for words in found)
