"""Parts that no pads would touch are told before anything is planned, refused by planning, seen by the audit.

Each mistake has a neighbour a hair on the other side of what is allowed, of which nobody says a word.
"""

from pathlib import Path

import pytest

from planning.errors import TwinError
from planning.grips import tool_grips
from planning.transforms import inverse
from tests.planning.robots.descriptions.vendors import robotiq, ur5e
from tests.twin.scenarios.executed import built
from tests.twin.written import Change, checked, refusal, written
from twin.reading.scenario_file import load_scenario
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.plan_result import given_plan
from twin.trial.planning import plan_scenario
from twin.trial.run_plan import run_plan_to_folder

CELL = """\
version: 1
name: holds
cell:
  tools:
    hand:
      shapes:
        - {box: [0.04, 0.1, 0.04], pose: {xyz_m: [0, 0, 0.02]}}
        - {box: [0.02, 0.01, 0.08], pose: {xyz_m: [0, 0.04, 0.08]}}
        - {box: [0.02, 0.01, 0.08], pose: {xyz_m: [0, -0.04, 0.08]}}
      tcp: {xyz_m: [0, 0, 0.12]}
      opening_m: 0.07
    cup:
      shapes: [{cylinder: {radius_m: 0.012, length_m: 0.1}, pose: {xyz_m: [0, 0, 0.05]}}]
      tcp: {xyz_m: [0, 0, 0.1]}
      suction: true
  robots:
    - {name: arm, model: ur5e, tool: hand, base: {xyz_m: [-0.5, 0, 0]}}
  fixtures:
    - {name: table, size_m: [1.8, 1.4, 0.04], pose: {xyz_m: [0, 0, -0.02]}}
assembly:
  kind: assembly
  grips: {positions: 1, depth_m: 0.02}
  parts:
    - {name: a, size_m: [0.03, 0.03, 0.03], start: {xyz_m: [0, 0.3, 0.015]}, goal: {xyz_m: [0, -0.3, 0.015]}, mass_kg: 0.2}
  steps: [a]
planning: {speed_model: joint}
execution:
  skills: {pick: {kind: fixed, value_s: 1}, place-down: {kind: fixed, value_s: 1}}
"""

TCP = "tcp: {xyz_m: [0, 0, 0.12]}"
CUP = "tool: hand", "tool: cup"

PLANTED: dict[str, tuple[list[Change], str, str]] = {
    "short of it": ([(TCP, "tcp: {xyz_m: [0, 0, 0.145]}")], "10.0 mm short of (depth)", "10.00 mm short of it (depth)"),
    "far short of it": ([(TCP, "tcp: {xyz_m: [0, 0, 0.178]}")], "43.0 mm short of (depth)", "43.00 mm short of it (depth)"),
    "beside it": ([(TCP, "tcp: {xyz_m: [0.035, 0, 0.12]}")], "10.0 mm beside (across)", "10.00 mm beside it (across)"),
    "a little beside it": ([(TCP, "tcp: {xyz_m: [0.026, 0, 0.12]}")], "1.0 mm beside (across)", "1.00 mm beside it (across)"),
    "off the middle": ([(TCP, "tcp: {xyz_m: [0, 0.003, 0.12]}")], "3.0 mm off the middle", "3.00 mm off the middle"),
    "above the face": ([CUP, ("[0, 0, 0.1]}", "[0, 0, 0.103]}")], "cup ends 3.0 mm away from a", "3.00 mm away from the cup"),
}  # fmt: skip
"""What is written, and what check and planning say of it, and the audit."""

SANE: dict[str, list[Change]] = {
    "as it is": [],
    "at its edge": [(TCP, "tcp: {xyz_m: [0, 0, 0.1348]}")],
    "half across it": [(TCP, "tcp: {xyz_m: [0.0245, 0, 0.12]}")],
    "nearly in the middle": [(TCP, "tcp: {xyz_m: [0, 0.0019, 0.12]}")],
    "nearly on the face": [CUP, ("[0, 0, 0.1]}", "[0, 0, 0.1009]}")],
}


@pytest.mark.parametrize("case", PLANTED)
def test_what_no_pads_would_touch_is_refused(case: str, tmp_path: Path) -> None:
    """By the check and by planning, in the same words."""
    changes, words, _ = PLANTED[case]
    file = written(tmp_path, CELL, *changes)
    report = checked(file)
    (finding,) = [
        item for item in report.errors if "by none of its grips" in item.message
    ]
    assert words in finding.message
    assert report.document.nearest(finding.at)
    with pytest.raises(TwinError) as refused:
        plan_scenario(load_scenario(file), tmp_path)
    assert words in str(refused.value)


@pytest.mark.parametrize("case", SANE)
def test_of_its_neighbours_the_check_says_nothing(case: str, tmp_path: Path) -> None:
    file = written(tmp_path, CELL, *SANE[case])
    assert [item.message for item in checked(file).findings] == []


@pytest.mark.nightly
@pytest.mark.parametrize("case", SANE)
def test_its_neighbours_are_planned_and_pass_the_audit(
    case: str, tmp_path: Path
) -> None:
    assert built(tmp_path, CELL, *SANE[case]).tpg.tasks


@pytest.mark.nightly
@pytest.mark.parametrize("case", PLANTED)
def test_the_audit_sees_what_planning_would_not_have_seen(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A planner that asks for no pads has its run, and the audit finds the grip in it."""
    monkeypatch.setattr(tool_grips, "explain_not_held", lambda *_, **__: None)
    changes, _, words = PLANTED[case]
    scenario = load_scenario(written(tmp_path, CELL, *changes))
    planned = plan_scenario(scenario, tmp_path)
    plan = given_plan(LoadedScenario(scenario, tmp_path), planned.tpg)
    run = tmp_path / "run"
    run.mkdir()
    trial = run_plan_to_folder(plan, run, recording=False)
    grips = [v for v in trial.summary["audit"]["violations"] if v["kind"] == "grip"]
    assert grips
    assert all(words in v["detail"] for v in grips), grips
    assert not trial.passed


def test_a_tool_that_holds_what_another_does_not_is_warned_of(tmp_path: Path) -> None:
    """A part is given to one whose tool holds it."""
    other = "    - {name: other, model: ur5e, tool: cup, base: {xyz_m: [0.5, 0, 0], rpy_deg: [0, 0, 180]}}\n"
    changes = [*PLANTED["beside it"][0], ("  fixtures:\n", other + "  fixtures:\n")]
    found = [
        item
        for item in checked(written(tmp_path, CELL, *changes)).findings
        if "grips" in item.message
    ]
    assert len(found) == 1
    assert not found[0].error
    assert "arm would hold a by none of its grips" in found[0].message
    alone = ("steps: [a]", "steps: [{place: a, robots: [arm]}]")
    report = checked(written(tmp_path, CELL, *changes, alone))
    assert [item.error for item in report.findings if "grips" in item.message] == [True]


def test_fingers_of_one_body_are_told_once(tmp_path: Path) -> None:
    """Whether they touch the part, nobody can tell: it is planned and audited as ever."""
    block = "        - {box: [0.04, 0.1, 0.12], pose: {xyz_m: [0, 0, 0.06]}}\n"
    a = CELL.index("        - {box"), CELL.index("      tcp")
    text = CELL[: a[0]] + block + CELL[a[1] :]
    found = checked(written(tmp_path, text)).findings
    words = [
        item.message for item in found if "neither planned nor audited" in item.message
    ]
    assert len(words) == 1
    assert not any(item.error for item in found)


@pytest.mark.parametrize(
    ("tcp", "thick", "words"),
    [
        (0.145, 0.04, None),
        (0.16, 0.04, None),
        (0.16, 0.002, "0.7 mm short of (depth) a, and must touch it: its tcp lies 1.7 mm beyond their tips"),
        (0.17, 0.02, "short of (depth)"),
        (0.205, 0.04, "26.7 mm short of (depth) a, and must touch it: its tcp lies 46.7 mm beyond"),
    ],
)  # fmt: skip
def test_a_vendors_gripper_reaches_as_far_as_its_fingers(
    tcp: float, thick: float, words: str | None, tmp_path: Path
) -> None:
    """A Robotiq 2F-85 that is held half closed: its tips are 158 mm in front of its mount."""
    a = CELL.index("      shapes:"), CELL.index("    cup:")
    tool = f"      description: {robotiq()}\n      joints: {{finger_joint: 0.3}}\n      closing: x\n"
    tool += f"      tcp: {{xyz_m: [0, 0, {tcp}]}}\n      opening_m: 0.085\n"
    size = f"[0.06, 0.04, {thick}]"
    changes = [
        ("model: ur5e", f"model: {ur5e()}"),
        ("size_m: [0.03, 0.03, 0.03]", f"size_m: {size}"),
    ]
    found = checked(
        written(tmp_path, CELL[: a[0]] + tool + CELL[a[1] :], *changes)
    ).findings
    held = [item.message for item in found if "grips" in item.message]
    assert bool(held) == (words is not None), held
    assert words is None or words in held[0]


BEAM = "a, size_m: [0.03, 0.03, 0.03]", "a, size_m: [0.24, 0.03, 0.03]"


@pytest.mark.parametrize(
    ("force", "centre", "words"),
    [
        (None, 0.08, None),
        (20, 0.0, None),
        (20, 0.08, "hold a (0.2 kg) at best 80.0 mm beside its centre of mass: 1.96 N pull along them and 0.157 N m"),
        (60, 0.08, None),
        (2, 0.0, "1.96 N pull along them"),
    ],
)  # fmt: skip
def test_what_friction_does_not_bear_is_warned_of(
    force: float | None, centre: float, words: str | None, tmp_path: Path
) -> None:
    """A beam is gripped in its middle, and is heavier at one end; pads touch 20 by 15 mm of it."""
    said = "" if force is None else f"\n      force_n: {force}"
    changes = [
        BEAM,
        ("mass_kg: 0.2", f"mass_kg: 0.2, centre_of_mass_m: [{centre}, 0, 0]"),
        ("opening_m: 0.07", f"opening_m: 0.07{said}"),
    ]
    found = checked(written(tmp_path, CELL, *changes)).findings
    assert not any(item.error for item in found)
    slips = [item.message for item in found if "friction bears" in item.message]
    assert bool(slips) == (words is not None), slips
    assert words is None or words in slips[0]


def test_force_is_of_fingers(tmp_path: Path) -> None:
    words = "force_n is of fingers: give opening_m as well"
    assert words in str(refusal(tmp_path, CELL, ("opening_m: 0.07", "force_n: 40")))
    assert "suction" in str(
        refusal(tmp_path, CELL, ("suction: true", "suction: true\n      force_n: 4"))
    )


@pytest.mark.expensive
def test_parts_are_gripped_where_friction_bears_them(tmp_path: Path) -> None:
    """A beam that is heavy at one end is taken there, and elsewhere where nobody says the force."""
    heavy = "mass_kg: 0.2", "mass_kg: 0.2, centre_of_mass_m: [0.1, 0, 0]"
    for force, firm in (("\n      force_n: 12", True), ("", False)):
        opens = "opening_m: 0.07", f"opening_m: 0.07{force}"
        changes = BEAM, heavy, opens, ("positions: 1", "positions: 5")
        tpg = built(tmp_path, CELL, *changes).tpg
        (pick,) = [task for task in tpg.tasks if task.kind == "pick"]
        (held,) = [h for h in pick.handlings if h.holder == "arm"]
        model = tpg.cell.robot("arm").model
        grip = inverse(held.pose) @ model.frames["tool"]
        assert (abs(grip[0, 3] - 0.1) < 0.01) == firm, grip[:3, 3]
