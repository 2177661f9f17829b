"""What no robot can do alone: a part is laid down in between, and taken up by another, or another way."""

from pathlib import Path

import pytest

from planning.errors import InfeasibleStepError
from tests.twin.scenarios.cells import cell, panda
from tests.twin.scenarios.executed import built
from tests.twin.written import loaded
from twin.trial.planning import plan_scenario

END = """\
planning: {speed_model: joint}
execution:
  skills:
    pick: {kind: lognormal, median_s: 1.5, p95_s: 1.9}
    place-down: {kind: lognormal, median_s: 1.5, p95_s: 2.0}
    handover: {kind: lognormal, median_s: 2.0, p95_s: 2.5}
  stalls: {rate_per_h: 120, duration_s: [1, 3]}
"""

FAR_APART = cell(
    "relay",
    (panda("left", -0.7), panda("right", 0.7)),
    f"""\
  kind: assembly
  grips: {{positions: 3}}
  parts:
    - {{name: bar, size_m: [0.12, 0.03, 0.03], start: {{xyz_m: [-0.7, 0.5, 0.0155]}}, goal: {{xyz_m: [0.7, -0.5, 0.0155]}}}}
    - {{name: post, size_m: [0.03, 0.03, 0.06], start: {{xyz_m: [-0.7, -0.5, 0.0305]}}, goal: {{xyz_m: [-0.3, 0.35, 0.0305]}}}}
  steps: [bar, post]
{END}""",
    "{name: table, size_m: [2.4, 1.2, 0.04], pose: {xyz_m: [0, 0, -0.02]}}",
)

TWO_TABLES = cell(
    "gap",
    (panda("left", -0.65), panda("right", 0.65)),
    f"""\
  kind: assembly
  grips: {{positions: 5}}
  parts:
    - {{name: bar, size_m: [0.24, 0.03, 0.03], start: {{xyz_m: [-0.65, 0.45, 0.0155]}}, goal: {{xyz_m: [0.65, -0.45, 0.0155]}}}}
    - {{name: rod, size_m: [0.03, 0.2, 0.03], start: {{xyz_m: [0.65, 0.45, 0.0155]}}, goal: {{xyz_m: [-0.65, -0.45, 0.0155]}}}}
  steps: [bar, {{place: rod, after: [bar]}}]
{END}""",
    "{name: west, size_m: [0.8, 1.2, 0.04], pose: {xyz_m: [-0.7, 0, -0.02]}}",
    "{name: east, size_m: [0.8, 1.2, 0.04], pose: {xyz_m: [0.7, 0, -0.02]}}",
)

TURNED_OVER = cell(
    "turned-over",
    (panda("arm", 0),),
    f"""\
  kind: assembly
  grips: {{positions: 1, depth_m: 0.015, tilts_deg: [0, 45, -45]}}
  parts:
    - name: block
      size_m: [0.06, 0.03, 0.05]
      start: {{xyz_m: [0.5, 0.2, 0.0255]}}
      goal: {{xyz_m: [0.5, -0.2, 0.0255], rpy_deg: [0, 180, 0]}}
  steps: [block]
{END}""",
    "{name: table, size_m: [1.6, 1.6, 0.04], pose: {xyz_m: [0, 0, -0.02]}}",
)


def handled(folder: Path, text: str) -> dict[int, list[tuple[str, str]]]:
    """Return who does what in which step of a plan that is proved safe, and whose run is clean."""
    found: dict[int, list[tuple[str, str]]] = {}
    for task in built(folder, text).tpg.tasks:
        if task.handlings:
            found.setdefault(task.step, []).append((task.robot, task.kind))
    return found


@pytest.mark.parametrize(
    ("text", "robots"),
    [(FAR_APART, ["left", "right"]), (TURNED_OVER, ["arm", "arm"])],
    ids=["two robots", "regrasp"],
)
def test_a_part_is_laid_down_in_between_and_the_audit_is_clean(
    tmp_path: Path, text: str, robots: list[str]
) -> None:
    giver, receiver = robots
    assert handled(tmp_path, text)[1] == [
        (giver, "pick"),
        (giver, "place-down"),
        (receiver, "pick"),
        (receiver, "place-down"),
    ]


@pytest.mark.nightly
def test_across_a_gap_parts_are_handed_over_and_the_audit_is_clean(
    tmp_path: Path,
) -> None:
    found = handled(tmp_path, TWO_TABLES)
    for step, giver, receiver in ((1, "left", "right"), (2, "right", "left")):
        there = [(giver, "pick"), (giver, "handover"), (receiver, "place-down")]
        assert found[step] == there


def test_what_one_robot_can_do_is_not_laid_down_nor_a_pinned_step_handed_to_others(
    tmp_path: Path,
) -> None:
    steps = "steps: [bar, post]"
    near = loaded(tmp_path, FAR_APART, (steps, "steps: [post]"))
    tasks = plan_scenario(near).tpg.tasks
    assert [t.kind for t in tasks if t.handlings] == ["pick", "place-down"]
    own = "steps: [{place: bar, robots: [right]}]"
    with pytest.raises(InfeasibleStepError, match="pick and place bar"):
        plan_scenario(loaded(tmp_path, FAR_APART, (steps, own)))
