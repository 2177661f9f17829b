"""What no robot can do alone: a part is laid down in between, and taken up by another, or another way."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from planning.errors import InfeasibleStepError
from scheduling.verification.verify import verify_plan
from tests.twin.scenarios.executed import executed
from twin.scenario.manifest import load_scenario
from twin.trial.planning import plan_scenario

FAR_APART = """\
version: 1
name: relay
cell:
  robots:
    - {name: left, model: panda, base: {xyz_m: [-0.7, 0, 0]}}
    - {name: right, model: panda, base: {xyz_m: [0.7, 0, 0], rpy_deg: [0, 0, 180]}}
  fixtures:
    - {name: table, size_m: [2.4, 1.2, 0.04], pose: {xyz_m: [0, 0, -0.02]}}
assembly:
  kind: assembly
  grips: {positions: 3}
  parts:
    - name: bar
      size_m: [0.12, 0.03, 0.03]
      start: {xyz_m: [-0.7, 0.5, 0.0155]}
      goal: {xyz_m: [0.7, -0.5, 0.0155]}
    - name: post
      size_m: [0.03, 0.03, 0.06]
      start: {xyz_m: [-0.7, -0.5, 0.0305]}
      goal: {xyz_m: [-0.3, 0.35, 0.0305]}
  steps: [bar, post]
planning: {speed_model: joint}
execution:
  skills:
    pick: {kind: lognormal, median_s: 1.5, p95_s: 1.9}
    place-down: {kind: lognormal, median_s: 1.5, p95_s: 2.0}
  stalls: {rate_per_h: 120, duration_s: [1, 3]}
"""

TWO_TABLES = """\
version: 1
name: gap
cell:
  robots:
    - {name: left, model: panda, base: {xyz_m: [-0.65, 0, 0]}}
    - {name: right, model: panda, base: {xyz_m: [0.65, 0, 0], rpy_deg: [0, 0, 180]}}
  fixtures:
    - {name: west, size_m: [0.8, 1.2, 0.04], pose: {xyz_m: [-0.7, 0, -0.02]}}
    - {name: east, size_m: [0.8, 1.2, 0.04], pose: {xyz_m: [0.7, 0, -0.02]}}
assembly:
  kind: assembly
  grips: {positions: 5}
  parts:
    - name: bar
      size_m: [0.24, 0.03, 0.03]
      start: {xyz_m: [-0.65, 0.45, 0.0155]}
      goal: {xyz_m: [0.65, -0.45, 0.0155]}
    - name: rod
      size_m: [0.03, 0.2, 0.03]
      start: {xyz_m: [0.65, 0.45, 0.0155]}
      goal: {xyz_m: [-0.65, -0.45, 0.0155]}
  steps: [bar, {place: rod, after: [bar]}]
planning: {speed_model: joint}
execution:
  skills:
    pick: {kind: lognormal, median_s: 1.5, p95_s: 1.9}
    place-down: {kind: lognormal, median_s: 1.5, p95_s: 2.0}
    handover: {kind: lognormal, median_s: 2.0, p95_s: 2.5}
  stalls: {rate_per_h: 120, duration_s: [1, 3]}
"""

TURNED_OVER = """\
version: 1
name: turned-over
cell:
  robots:
    - {name: arm, model: panda, base: {xyz_m: [0, 0, 0]}}
  fixtures:
    - {name: table, size_m: [1.6, 1.6, 0.04], pose: {xyz_m: [0, 0, -0.02]}}
assembly:
  kind: assembly
  grips: {positions: 1, depth_m: 0.015, tilts_deg: [0, 45, -45]}
  parts:
    - name: block
      size_m: [0.06, 0.03, 0.05]
      start: {xyz_m: [0.5, 0.2, 0.0255]}
      goal: {xyz_m: [0.5, -0.2, 0.0255], rpy_deg: [0, 180, 0]}
  steps: [block]
planning: {speed_model: joint}
execution:
  skills:
    pick: {kind: fixed, value_s: 1.5}
    place-down: {kind: fixed, value_s: 1.5}
"""


@pytest.mark.parametrize(
    ("text", "robots"),
    [(FAR_APART, ["left", "right"]), (TURNED_OVER, ["arm", "arm"])],
    ids=["two robots", "regrasp"],
)
def test_a_part_is_laid_down_in_between_and_the_audit_is_clean(
    tmp_path: Path, text: str, robots: list[str]
) -> None:
    file = tmp_path / "relay.yaml"
    file.write_text(text)
    scenario = load_scenario(file)
    tpg = plan_scenario(scenario).tpg
    assert verify_plan(tpg).problems == ()
    first = [task for task in tpg.tasks if task.step == 1]
    handled = [(t.robot, t.kind) for t in first if t.handlings]
    assert handled == [
        (robots[0], "pick"),
        (robots[0], "place-down"),
        (robots[1], "pick"),
        (robots[1], "place-down"),
    ]
    executed(scenario, tpg, tmp_path / "run")


def test_across_a_gap_parts_are_handed_over_and_the_audit_is_clean(
    tmp_path: Path,
) -> None:
    file = tmp_path / "gap.yaml"
    file.write_text(TWO_TABLES)
    scenario = load_scenario(file)
    tpg = plan_scenario(scenario).tpg
    assert verify_plan(tpg).problems == ()
    for step, (giver, receiver) in ((1, ("left", "right")), (2, ("right", "left"))):
        handled = [
            (t.robot, t.kind) for t in tpg.tasks if t.handlings and t.step == step
        ]
        assert handled == [
            (giver, "pick"),
            (giver, "handover"),
            (receiver, "place-down"),
        ]
    executed(scenario, tpg, tmp_path / "run")


def test_what_one_robot_can_do_is_not_laid_down(tmp_path: Path) -> None:
    content = yaml.safe_load(FAR_APART)
    content["assembly"]["steps"] = ["post"]
    file = tmp_path / "near.yaml"
    file.write_text(yaml.safe_dump(content))
    tpg = plan_scenario(load_scenario(file)).tpg
    assert [t.kind for t in tpg.tasks if t.handlings] == ["pick", "place-down"]


def test_a_pinned_step_is_not_handed_to_others(tmp_path: Path) -> None:
    content = yaml.safe_load(FAR_APART)
    content["assembly"]["steps"] = [{"place": "bar", "robots": ["right"]}]
    file = tmp_path / "pinned.yaml"
    file.write_text(yaml.safe_dump(content))
    with pytest.raises(InfeasibleStepError, match="pick and place bar"):
        plan_scenario(load_scenario(file))
