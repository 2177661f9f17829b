"""A beam that would fall off a post: refused, propped in a found order, or joined, up to the audit."""

from __future__ import annotations

from pathlib import Path

import pytest

from planning.errors import InfeasibleStepError
from tests.twin.scenarios.executed import executed
from twin.check.finding import Subject
from twin.check.lying import check_balance
from twin.scenario.document.validation import InvalidScenarioError
from twin.scenario.manifest import load_scenario
from twin.scenario.sections.scenario import Scenario
from twin.trial.planning import plan_scenario

SCENARIO = """\
version: 1
name: cantilever
cell:
  robots:
    - {name: arm, model: panda, base: {xyz_m: [-0.5, 0, 0]}}
  fixtures:
    - {name: table, size_m: [1.6, 1.4, 0.02], pose: {xyz_m: [0, 0, -0.01]}}
assembly:
  kind: assembly
  grips: {positions: 3, depth_m: 0.012}
  parts:
    - {name: post, size_m: [0.03, 0.03, 0.06], start: {xyz_m: [-0.1, 0.3, 0.0305]}, goal: {xyz_m: [0, 0, 0.0305]}}
    - {name: prop, size_m: [0.03, 0.03, 0.06], start: {xyz_m: [-0.2, 0.3, 0.0305]}, goal: {xyz_m: [0.1, 0, 0.0305]}}
    - {name: beam, size_m: [0.16, 0.03, 0.03], start: {xyz_m: [-0.1, -0.3, 0.0155]}, goal: {xyz_m: [0.04, 0, 0.076]}}
  steps: [post, beam, prop]
planning: {speed_rad_s: 4.0, shortcut_candidates: 0}
"""


def scenario(tmp_path: Path, old: str = "", new: str = "") -> Scenario:
    assert old in SCENARIO
    file = tmp_path / "cantilever.yaml"
    file.write_text(SCENARIO.replace(old, new))
    return load_scenario(file)


def test_it_is_refused_before_anything_is_planned(tmp_path: Path) -> None:
    given = scenario(tmp_path)
    with pytest.raises(InfeasibleStepError, match="beam would not stand") as caught:
        plan_scenario(given)
    assert "joined: [[post, beam]]" in str(caught.value)
    assert "place prop before" in str(caught.value)
    (finding,) = check_balance(Subject(given, tmp_path))
    assert finding.error
    assert finding.at == ("assembly", "parts", 2, "goal")


def test_the_check_can_be_turned_off(tmp_path: Path) -> None:
    off = scenario(tmp_path, "steps:", "balance: {check: false}\n  steps:")
    assert not list(check_balance(Subject(off, tmp_path)))


@pytest.mark.parametrize(
    ("new", "order"),
    [
        ("order: find\n  steps: [post, beam, prop]", ["post", "prop", "beam"]),
        (
            "joined: [[table, post], [post, beam]]\n  steps: [post, beam]",
            ["post", "beam"],
        ),
    ],
)
def test_a_prop_or_a_joint_keeps_it_up(
    new: str, order: list[str], tmp_path: Path
) -> None:
    given = scenario(tmp_path, "steps: [post, beam, prop]", new)
    planned = plan_scenario(given)
    placed = [t.object for t in planned.tpg.tasks if t.kind == "place-down"]
    assert placed == order
    executed(given, planned.tpg, tmp_path / "run", recording=True)


def test_the_centre_of_mass_decides_what_falls(tmp_path: Path) -> None:
    there = "goal: {xyz_m: [0.04, 0, 0.076]}"
    heavy_end = f"centre_of_mass_m: [-0.04, 0, 0], {there}"
    file = tmp_path / "cantilever.yaml"
    file.write_text(SCENARIO.replace(there, heavy_end).replace("beam, prop]", "beam]"))
    given = load_scenario(file)
    planned = plan_scenario(given)
    executed(given, planned.tpg, tmp_path / "run", recording=True)
    file.write_text(file.read_text().replace("[-0.04,", "[0.01,"))
    with pytest.raises(InfeasibleStepError, match="beam would not stand"):
        plan_scenario(load_scenario(file))


def test_what_hangs_on_a_joint_hangs_for_the_audit_without_it(tmp_path: Path) -> None:
    """The beam stops 5 mm above the post: held by the joint alone."""
    higher = "goal: {xyz_m: [0.04, 0, 0.081]}"
    file = tmp_path / "cantilever.yaml"
    joints = "[[table, post], {parts: [post, beam], gap_m: 0.006}]"
    joined = f"joined: {joints}\n  steps: [post, beam]\n#"
    text = SCENARIO.replace("goal: {xyz_m: [0.04, 0, 0.076]}", higher)
    file.write_text(text.replace("steps:", joined))
    given = load_scenario(file)
    planned = plan_scenario(given)
    executed(given, planned.tpg, tmp_path / "run", recording=True)
    bare = load_scenario(_without_joint(file))
    with pytest.raises(InfeasibleStepError, match="in the air"):
        plan_scenario(bare)


def _without_joint(file: Path) -> Path:
    other = file.with_name("bare.yaml")
    other.write_text(
        file.read_text().replace(", {parts: [post, beam], gap_m: 0.006}]", "]")
    )
    return other


@pytest.mark.parametrize(
    ("joined", "said"),
    [
        ("[[post, bean]]", "unknown part or fixture 'bean'"),
        ("[[post, post]]", "cannot be joined to itself"),
        ("[{parts: [post, beam], by: weld}]", "unknown step 'weld'"),
        ("[[table, table2]]", "table2"),
        ("[[post]]", "2"),
    ],
)
def test_joints_name_what_there_is(joined: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidScenarioError, match=said):
        scenario(tmp_path, "steps:", f"joined: {joined}\n  steps:")
