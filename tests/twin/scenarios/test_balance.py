"""A beam that would fall off a post: refused, propped in a found order, or joined, up to the audit."""

from __future__ import annotations

from pathlib import Path

import pytest

from planning.errors import InfeasibleStepError
from tests.twin.scenarios.cells import cell, panda
from tests.twin.scenarios.executed import built
from tests.twin.written import loaded
from twin.check.finding import Subject
from twin.check.lying import check_balance
from twin.trial.planning import plan_scenario

SCENARIO = cell(
    "cantilever",
    (panda("arm", -0.5),),
    """\
  kind: assembly
  grips: {positions: 3, depth_m: 0.012}
  parts:
    - {name: post, size_m: [0.03, 0.03, 0.06], start: {xyz_m: [-0.1, 0.3, 0.0305]}, goal: {xyz_m: [0, 0, 0.0305]}}
    - {name: prop, size_m: [0.03, 0.03, 0.06], start: {xyz_m: [-0.2, 0.3, 0.0305]}, goal: {xyz_m: [0.1, 0, 0.0305]}}
    - {name: beam, size_m: [0.16, 0.03, 0.03], start: {xyz_m: [-0.1, -0.3, 0.0155]}, goal: {xyz_m: [0.04, 0, 0.076]}}
  steps: [post, beam, prop]
planning: {speed_rad_s: 4.0, shortcut_candidates: 0}
""",
)
BEAM, JOINED = (
    "goal: {xyz_m: [0.04, 0, 0.076]}",
    "joined: [[table, post], [post, beam]]",
)
STEPS = "steps: [post, beam, prop]"


def test_it_is_refused_before_anything_is_planned(tmp_path: Path) -> None:
    given = loaded(tmp_path, SCENARIO)
    with pytest.raises(InfeasibleStepError, match="beam would not stand") as caught:
        plan_scenario(given)
    assert "joined: [[post, beam]]" in str(caught.value)
    assert "place prop before" in str(caught.value)
    (finding,) = check_balance(Subject(given, tmp_path))
    assert finding.error
    assert finding.at == ("assembly", "parts", 2, "goal")


def test_the_check_can_be_turned_off(tmp_path: Path) -> None:
    unchecked = "steps:", "balance: {check: false}\n  steps:"
    off = loaded(tmp_path, SCENARIO, unchecked)
    assert not list(check_balance(Subject(off, tmp_path)))


@pytest.mark.parametrize(
    ("new", "order"),
    [
        (f"order: find\n  {STEPS}", ["post", "prop", "beam"]),
        (f"{JOINED}\n  steps: [post, beam]", ["post", "beam"]),
    ],
)
def test_a_prop_or_a_joint_keeps_it_up(
    new: str, order: list[str], tmp_path: Path
) -> None:
    tasks = built(tmp_path, SCENARIO, (STEPS, new), recording=True).tpg.tasks
    assert [t.object for t in tasks if t.kind == "place-down"] == order


def test_the_centre_of_mass_decides_what_falls(tmp_path: Path) -> None:
    alone = "beam, prop]", "beam]"
    built(tmp_path, SCENARIO, (BEAM, f"centre_of_mass_m: [-0.04, 0, 0], {BEAM}"), alone)
    ahead = BEAM, f"centre_of_mass_m: [0.01, 0, 0], {BEAM}"
    with pytest.raises(InfeasibleStepError, match="beam would not stand"):
        plan_scenario(loaded(tmp_path, SCENARIO, ahead, alone))


def test_what_hangs_on_a_joint_hangs_for_the_audit_without_it(tmp_path: Path) -> None:
    """The beam stops 5 mm above the post: held by the joint alone."""
    higher = BEAM, BEAM.replace("0.076", "0.081")
    steps = "\n  steps: [post, beam]"
    gap = "joined: [[table, post], {parts: [post, beam], gap_m: 0.006}]"
    built(tmp_path, SCENARIO, higher, (STEPS, gap + steps))
    bare = loaded(
        tmp_path, SCENARIO, higher, (STEPS, "joined: [[table, post]]" + steps)
    )
    with pytest.raises(InfeasibleStepError, match="in the air"):
        plan_scenario(bare)
