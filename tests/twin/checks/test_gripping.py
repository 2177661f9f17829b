"""What the audit would find of grips and places, the check finds before anything is planned: of parts, kind by kind."""

from dataclasses import replace
from pathlib import Path

import pytest

from planning.kinematics.kinematics import frame_pose
from planning.parts.part_skills import ToolSkills
from planning.tasks.assignment import NO_TOOLS
from tests.twin.written import Change, checked, written
from twin.checks.finding import CheckContext
from twin.checks.picture import _doors, cell_figure
from twin.kinds.parts.checks.context import ordered_parts
from twin.reading.scenario_file import load_scenario
from twin.trial.planning import plan_scenario

CELL = """\
version: 1
name: grips
cell:
  tools:
    hand:
      shapes:
        - {box: [0.05, 0.12, 0.04], pose: {xyz_m: [0, 0, 0.02]}}
        - {box: [0.02, 0.01, 0.07], pose: {xyz_m: [0, 0.035, 0.075]}}
        - {box: [0.02, 0.01, 0.07], pose: {xyz_m: [0, -0.035, 0.075]}}
      tcp: {xyz_m: [0, 0, 0.105]}
      opening_m: [0.005, 0.06]
    cup: {shapes: [{cylinder: {radius_m: 0.009, length_m: 0.07}, pose: {xyz_m: [0, 0, 0.035]}}], tcp: {xyz_m: [0, 0, 0.07]}, suction: true}
  robots:
    - {name: arm, model: ur5e, tool: hand, base: {xyz_m: [-0.45, 0, 0]}}
  fixtures:
    - {name: table, size_m: [1.6, 1.4, 0.04], pose: {xyz_m: [0, 0, -0.02]}}
assembly:
  kind: assembly
  sources:
    rack: {kind: tray, pose: {xyz_m: [0, 0.3, 0.02]}, grid: {counts: [1, 3], pitch_m: [0.1, 0.13]}, refill_s: 10}
  parts:
    - {name: plug, size_m: [0.03, 0.03, 0.04], mass_kg: 0.1, source: rack, goal: {xyz_m: [0.05, -0.25, 0.02]}}
  steps: [plug]
  products: {count: 4, leave_s: 3}
  grips: {depth_m: 0.02, positions: 1}
planning: {speed_model: joint}
execution: {skills: {pick: {kind: fixed, value_s: 1}, place-down: {kind: fixed, value_s: 1}}}
"""

CUP: Change = ("tool: hand", "tool: cup")
TCP = "tcp: {xyz_m: [0, 0, 0.105]}"
BELT: Change = (
    "{kind: tray, pose: {xyz_m: [0, 0.3, 0.02]}, grid: {counts: [1, 3], pitch_m: [0.1, 0.13]}, refill_s: 10}",
    "{kind: conveyor, pose: {xyz_m: [0, 0.3, 0.02]}, every: {kind: fixed, value_s: 9}, buffer: 2, advance_s: 1}",
)
GOAL = "goal: {xyz_m: [0.05, -0.25, 0.02]}"

AUDITED: dict[str, tuple[list[Change], str, bool]] = {
    "grip: wider than its fingers open": (
        [("size_m: [0.03, 0.03, 0.04]", "size_m: [0.07, 0.08, 0.07]")], "no fingers span plug.1: its shortest edge is 70.0 mm", True),
    "grip: fingers pass it": ([(TCP, "tcp: {xyz_m: [0, 0, 0.15]}")], "short of (depth) plug.1, and must touch it", True),
    "grip: off the middle": ([(TCP, "tcp: {xyz_m: [0, 0.006, 0.105]}")], "6.0 mm off the middle between the fingers of hand", True),
    "grip: closes 40 mm beside its pads": ([(TCP, "tcp: {xyz_m: [0.04, 0, 0.105]}")], "15.0 mm beside (across) plug.1", True),
    "grip: closes beside both fingers": ([(TCP, "tcp: {xyz_m: [0, 0.08, 0.105]}")], "nothing of hand on both sides of its tcp", False),
    "grip: away from the cup": ([CUP, ("[0, 0, 0.07]}, suction", "[0, 0, 0.074]}, suction")], "cup ends 4.0 mm away from plug.1", True),
    "grip: beside the cup": ([CUP, ("[0, 0, 0.07]}, suction", "[0.015, 0, 0.07]}, suction")], "mm beside what is at plug.1", True),
    "grip: a finger meets a neighbour": ([("[0.1, 0.13]", "[0.04, 0.04]"), ("[1, 3]", "[3, 3]")], "no grip on plug.1 has room beside its neighbours where it lies", True),
    "place: in another": ([("  steps:", "    - {name: peg, size_m: [0.02, 0.02, 0.04], start: {xyz_m: [0.05, -0.25, 0.02]}}\n  steps:")], "plug.1 goes where peg is by then", True),
    "hanging: at the start": ([("xyz_m: [0, 0.3, 0.02]", "xyz_m: [0, 0.3, 0.09]")], "plug.1 hangs in the air at the start", False),
    "hanging: in its place": ([(GOAL, "goal: {xyz_m: [0.05, -0.25, 0.06]}")], "plug.1 would be left in the air", True),
    "balance": ([(GOAL, "goal: {xyz_m: [0.811, -0.25, 0.02]}"), ("base: {xyz_m: [-0.45, 0, 0]}", "base: {xyz_m: [0.4, 0, 0]}")], "plug.1 would not stand after it", True),
}  # fmt: skip
"""By kind of violation and what it is: what is written, what the check says, and whether that is an error.

Jumps and supports are of executed motions, and tools in racks are told with their ways there.
"""


def messages(folder: Path, *changes: Change) -> list[tuple[str, bool, str]]:
    report = checked(written(folder, CELL, *changes))
    return [
        (item.message, item.error, ".".join(map(str, item.at)))
        for item in report.findings
    ]


@pytest.mark.parametrize("kind", AUDITED)
def test_what_the_audit_would_find_is_told_before(kind: str, tmp_path: Path) -> None:
    changes, words, error = AUDITED[kind]
    found = messages(tmp_path, *changes)
    assert [own for own in found if words in own[0] and own[1] == error], found


SANE: dict[str, list[Change]] = {
    "as it is": [],
    "a cup": [CUP],
    "a cup just as wide as the part": [CUP, ("radius_m: 0.009", "radius_m: 0.015")],
    "a pitch that is enough": [("[0.1, 0.13]", "[0.1, 0.056]")],
    "a belt and a long way up": [BELT, ("  grips:", "  leave_m: 0.05\n  grips:")],
}


@pytest.mark.parametrize("what", SANE)
def test_of_what_is_right_nothing_is_said(what: str, tmp_path: Path) -> None:
    assert messages(tmp_path, *SANE[what]) == []


@pytest.mark.nightly
@pytest.mark.parametrize("what", SANE)
def test_what_is_right_is_planned(what: str, tmp_path: Path) -> None:
    file = written(tmp_path, CELL, *SANE[what])
    assert plan_scenario(load_scenario(file), tmp_path)


@pytest.mark.parametrize("pitch", [0.031, 0.04, 0.0499])
def test_a_tray_that_is_too_tight_is_told_by_its_pitch(
    pitch: float, tmp_path: Path
) -> None:
    """Open fingers are 30 to 40 mm away from the middle, the next part from the pitch less 15 mm on, to that and 15."""
    found = messages(
        tmp_path, ("[0.1, 0.13]", f"[{pitch}, {pitch}]"), ("[1, 3]", "[3, 3]")
    )
    ((words, error, key),) = found
    assert error
    assert key == "assembly.sources.rack.grid.pitch_m"
    lack = float(words.partition(" lacks least, ")[2].partition(" mm")[0])
    assert lack == pytest.approx(1e3 * min(0.055 - pitch, pitch - 0.015), abs=0.1)


def test_a_cup_wider_than_the_part_is_refused(tmp_path: Path) -> None:
    """Also where cup_m says that a smaller spot will do: it is drawn wider."""
    wide = [CUP, ("radius_m: 0.009", "radius_m: 0.025")]
    for own in ([], [("  grips: {", "  grips: {cup_m: 0.004, ")]):
        found = messages(tmp_path, *wide, *own)
        assert any(error and "the cup is 50.0 mm wide" in w for w, error, _ in found)
        assert all("takes is " in words for words, _, _ in found)


@pytest.mark.parametrize("leave", [0.03, 0.04, 0.041])
def test_a_part_must_be_lifted_clear_of_the_next_one(
    leave: float, tmp_path: Path
) -> None:
    found = messages(tmp_path, BELT, ("  grips:", f"  leave_m: {leave}\n  grips:"))
    if leave > 0.04:
        assert found == []
        return
    ((words, error, key),) = found
    assert error
    assert key == "assembly.leave_m"
    assert f"lifted by leave_m {leave:g}" in words
    assert float(words.rpartition(": ")[2].split()[0]) == pytest.approx(0.045)


GANTRY = """<robot name="gantry">
  <link name="frame"><collision><origin xyz="0 0 1.3"/><geometry><box size="0.05 0.05 0.05"/></geometry></collision></link>
  <link name="beam"><collision><geometry><box size="0.05 0.8 0.05"/></geometry></collision></link>
  <link name="cart"><collision><geometry><box size="0.08 0.08 0.08"/></geometry></collision></link>
  <link name="ram"><collision><origin xyz="0 0 0.2"/><geometry><box size="0.03 0.03 0.4"/></geometry></collision></link>
  <link name="end"><collision><origin xyz="0 0 0.01"/><geometry><box size="0.03 0.03 0.02"/></geometry></collision></link>
  <joint name="x" type="prismatic"><parent link="frame"/><child link="beam"/><origin xyz="0 0 1.1"/><axis xyz="1 0 0"/><limit lower="-0.6" upper="0.6" effort="90" velocity="1"/></joint>
  <joint name="y" type="prismatic"><parent link="beam"/><child link="cart"/><origin xyz="0.1 0 0"/><axis xyz="0 1 0"/><limit lower="-0.5" upper="0.5" effort="90" velocity="1"/></joint>
  <joint name="z" type="prismatic"><parent link="cart"/><child link="ram"/><origin xyz="0.07 0 -0.1" rpy="3.14159265 0 0"/><axis xyz="0 0 1"/><limit lower="0" upper="0.6" effort="90" velocity="1"/></joint>
  <joint name="last" type="fixed"><parent link="ram"/><child link="end"/><origin xyz="0 0 0.4"/></joint>
</robot>"""

PLAIN: Change = (
    "source: rack, " + GOAL,
    "start: {xyz_m: [0, 0.2, 0.02]}, goal: {xyz_m: [0.05, -0.25, 0.02]}",
)
OF_ONE = [
    ("model: ur5e, tool: hand, base: {xyz_m: [-0.45, 0, 0]}", "model: gantry.urdf, tool: hand"),
    (CELL[CELL.index("  sources") : CELL.index("  parts")], ""),
    ("  products: {count: 4, leave_s: 3}\n", ""),
    PLAIN,
]  # fmt: skip


@pytest.mark.parametrize(
    ("turns", "goal", "told"),
    [
        ("fixed", "", False),
        ("fixed", ", rpy_deg: [0, 0, 40]", True),
        ("fixed", ", rpy_deg: [0, 90, 0]", True),
        ("revolute", ", rpy_deg: [0, 0, 40]", False),
        ("revolute", ", rpy_deg: [30, 0, 0]", True),
    ],
)
def test_a_gantry_turns_parts_as_far_as_it_can(
    turns: str, goal: str, told: bool, tmp_path: Path
) -> None:
    joint = f'type="{turns}"><parent link="ram"/>'
    text = GANTRY.replace('type="fixed"><parent link="ram"/>', joint)
    more = '<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="9" velocity="1"/></joint>\n</robot>'
    if turns == "revolute":
        text = text.replace("</joint>\n</robot>", more)
    (tmp_path / "gantry.urdf").write_text(text)
    place = ("-0.25, 0.02]}}", f"-0.25, 0.05]{goal}}}}}")
    found = messages(tmp_path, *OF_ONE, place)
    own = [words for words, error, _ in found if error and "cannot be gripped" in words]
    assert bool(own) == told, found
    if told and turns == "fixed":
        assert "its 3 slides turn nothing: tool direction fixed at (0.00, 0.00, -1.00)" in own[0]  # fmt: skip
        assert "; needed: " in own[0]


RACKS = """\
    hand:
      rack: {xyz_m: [-0.3, -0.5, 0.3], rpy_deg: [180, 0, 0]}"""


def test_a_door_is_free_of_a_robot_with_each_of_its_tools(tmp_path: Path) -> None:
    """Tools on one flange at once would be in each other; the longer one alone reaches the door."""
    text = CELL.replace("    hand:", RACKS).replace(
        "suction: true}",
        "suction: true, rack: {xyz_m: [-0.1, -0.5, 0.3], rpy_deg: [180, 0, 0]}}",
    )
    text = text.replace("tool: hand, ", "tools: [hand, cup], ")
    text = text.replace(
        "  steps: [plug]", "  steps: [plug, {process: bake, at: {part: plug}}]"
    )
    text = text.replace(CELL[CELL.index("  sources") : CELL.index("  parts")], "")
    text = text.replace("  products: {count: 4, leave_s: 3}\n", "").replace(*PLAIN)
    door = (
        "  machines: {oven: {door: {size_m: [0.3, 0.02, 0.3], pose: {xyz_m: [%s]}}}}\n"
    )
    bake = "  processes: {bake: {machine: oven, duration: {kind: fixed, value_s: 5}}}\n"
    plain = CheckContext(load_scenario(written(tmp_path, text.replace(", {process: bake, at: {part: plug}}", ""))), tmp_path)  # fmt: skip
    (robot,) = plain.built.robots
    long = replace(robot, model=robot.tools[0].model)
    under = frame_pose(long, robot.home, "tool")[:3, 3] - (0.0, 0.0, 0.14)
    for at, who in (([0.05, -0.1, 0.16], None), (under.tolist(), "arm with hand")):
        words = door % ", ".join(map(str, at)) + bake
        file = written(tmp_path, text.replace("  parts:", words + "  parts:"))
        subject = CheckContext(load_scenario(file), tmp_path)
        parts = ordered_parts(subject)
        skills = ToolSkills(subject.built, parts.listed)(NO_TOOLS)
        assert skills.in_door("oven.door") == who
        assert [name for name, _ in _doors(subject)] == ["oven.door"]
        assert cell_figure(subject, detail=False).axes
