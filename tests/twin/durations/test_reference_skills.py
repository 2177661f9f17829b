"""Skills that take as long as their reference paths, as in the simulations of APEX-MR."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from planning.errors import ScenarioError
from planning.tasks.task import TRANSIT
from scheduling.build_tpg import build_nodes
from tests.twin.drawn_runs import sample
from twin.cli import app
from twin.durations.measured import packaged_timings
from twin.host.progress import StageWatch
from twin.planning.pipeline import plan_in_turns, plan_motions
from twin.scenario.manifest import load_scenario
from twin.scenario.sections.scenario import follow_references
from twin.trial.simulation import skill_durations
from twin.uncertainty.skill_durations import SkillDurations

ROOT = Path(__file__).parents[3]
CLIFF = ROOT / "scenarios" / "lego" / "cliff.yaml"
TOWER = ROOT / "scenarios" / "construction" / "tower.yaml"


def test_they_move_at_the_speed_of_transits_and_never_vary() -> None:
    scenario = follow_references(load_scenario(CLIFF))
    assert scenario.execution.skill_models() == {}
    turns = plan_in_turns(scenario, CLIFF.parent, StageWatch())
    speed = scenario.planning.l1_rad_s
    seen = set()
    for task, motion in zip(
        turns.motion_plan.tasks, turns.motion_plan.motions, strict=True
    ):
        if task.kind == TRANSIT:
            continue
        seen.add(task.kind)
        travel = np.abs(np.diff(motion.path, axis=0)).sum(axis=1)
        np.testing.assert_allclose(np.diff(motion.time), travel / speed, atol=1e-9)
    assert {"pick", "place-down", "place-up", "handover"} <= seen
    tpg = build_nodes(turns.motion_plan)
    durations = skill_durations(scenario)
    first, other = (sample(durations, tpg, seed=seed) for seed in (1, 2))
    for a, b, planned in zip(
        first, other, sample(SkillDurations({}), tpg, seed=0), strict=True
    ):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(a, planned)


def test_exceptions_go_with_the_durations(tmp_path: Path) -> None:
    text = CLIFF.read_text() + (
        "\nexecution:\n  skill_overrides:\n"
        "    - {skill: pick, robot: left, duration: {kind: fixed, value_s: 90}}\n"
    )
    file = tmp_path / "cliff.yaml"
    file.write_text(text)
    scenario = load_scenario(file)
    assert skill_durations(scenario).model_of("pick", "left", None) is not None
    assert skill_durations(follow_references(scenario)).overrides == ()


def test_the_planner_takes_the_means_of_exceptions(tmp_path: Path) -> None:
    text = CLIFF.read_text() + (
        "\nexecution:\n  skills:\n    place-down: {kind: reference}\n  skill_overrides:\n"
        "    - {skill: pick, robot: left, duration: {kind: uniform, low_s: 80, high_s: 100}}\n"
        "    - {skill: pick, object: 2x4, duration: {kind: fixed, value_s: 50}}\n"
    )
    file = tmp_path / "cliff.yaml"
    file.write_text(text)
    scenario = load_scenario(file)
    plan = plan_in_turns(scenario, tmp_path, StageWatch()).motion_plan
    kinds = {item.name: item.kind for item in plan.cell.objects}
    packaged = packaged_timings()["pick"].mean
    seen = set()
    for task, motion in zip(plan.tasks, plan.motions, strict=True):
        if task.kind != "pick":
            continue
        assert task.object is not None
        case = (task.robot, kinds[task.object] == "2x4")
        expected = 90 if case[0] == "left" else 50 if case[1] else packaged
        assert motion.time[-1] - motion.time[0] == pytest.approx(expected)
        seen.add(case)
    assert {robot for robot, _ in seen} == {"left", "right"}
    assert ("right", True) in seen or ("right", False) in seen


@pytest.mark.parametrize(
    ("written", "says"),
    [
        ("{kind: referense}", "did you mean 'reference'?"),
        ("{kind: reference, scale: 2}", "scale"),
        ("{kind: shifted, offset_s: 1, model: {kind: reference}}", "'reference'"),
    ],
)
def test_what_a_reference_cannot_be(tmp_path: Path, written: str, says: str) -> None:
    file = tmp_path / "cliff.yaml"
    file.write_text(
        CLIFF.read_text() + f"\nexecution:\n  skills:\n    pick: {written}\n"
    )
    result = CliRunner().invoke(app, ["validate", str(file)])
    assert result.exit_code == 2
    assert says in result.output


def test_a_construction_needs_durations_to_plan_with() -> None:
    scenario = follow_references(load_scenario(TOWER))
    with pytest.raises(ScenarioError, match="pick: a construction"):
        plan_motions(scenario, TOWER.parent, StageWatch())


def test_the_comparison_takes_them_in_place_of_the_durations(tmp_path: Path) -> None:
    file = tmp_path / "cliff.yaml"
    file.write_text(
        CLIFF.read_text()
        + "\nexecution:\n  skills:\n    pick: {kind: fixed, value_s: 1000}\n"
    )
    out = tmp_path / "out"
    arguments = ["compare", str(file), "--reference-skills", "--json"]
    arguments += ["--seeds", "1", "--shortcuts", "0", "--out", str(out)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["sequential"]["makespan_s"]["mean"] < 400
    about = json.loads((out / "manifest.json").read_text())
    assert about["scenario"]["execution"]["skills"]["pick"] == {"kind": "reference"}
