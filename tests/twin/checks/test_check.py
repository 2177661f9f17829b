"""The check before planning: one planted mistake of each kind is found at its line."""

import json
import operator
import re
import time
from pathlib import Path

import pytest

from planning.errors import TwinError
from tests.planted import planted
from tests.twin.program import invoke
from tests.twin.written import Change, checked, written
from twin.reading.scenario_file import read_scenario
from twin.trial.planning import plan_scenario

ROOT = Path(__file__).parents[3]
SHIPPED = sorted(ROOT.glob("scenarios/*/*.yaml"))

CELL = """\
version: 1
name: own
cell:
  robots:
    - name: left
      model: panda
      base: {xyz_m: [-0.6, 0, 0]}
    - name: right
      model: panda
      base: {xyz_m: [0.6, 0, 0], rpy_deg: [0, 0, 180]}
  fixtures:
    - {name: table, size_m: [2, 2, 0.04], pose: {xyz_m: [0, 0, -0.02]}}
    - {name: rack, size_m: [0.3, 0.3, 0.1], pose: {xyz_m: [0, 0.3, 0.05]}}
assembly:
  kind: assembly
  parts:
    - name: a
      size_m: [0.1, 0.03, 0.03]
      start: {xyz_m: [-0.2, -0.2, 0.0155]}
      goal: {xyz_m: [0, 0.3, 0.1155]}
    - name: b
      size_m: [0.1, 0.03, 0.03]
      start: {xyz_m: [-0.2, -0.3, 0.0155]}
      goal: {xyz_m: [0, 0.4, 0.1155]}
  steps: [a, b]
planning: {speed_model: joint}
execution:
  skills:
    pick: {kind: fixed, value_s: 2}
    place-down: {kind: fixed, value_s: 2}
"""

MISTAKES = planted(r"""
mistake                         | old                                          | new                                          | level   | says                                         | at line
parts in each other             | [-0.2, -0.3, 0.0155]                         | [-0.2, -0.21, 0.0155]                        | error   | a and b overlap by 20.0 mm at the start      | start: {xyz_m: [-0.2, -0.2,
part in a fixture               | [-0.2, -0.3, 0.0155]                         | [-0.2, -0.3, 0.005]                          | error   | b and table overlap by 10.0 mm at the start  | ""
goals in each other             | [0, 0.4, 0.1155]                             | [0, 0.31, 0.1155]                            | error   | b goes where a is by then: they would overlap by 20.0 mm | ""
goal in the air                 | [0, 0.4, 0.1155]                             | [0, 0.4, 0.15]                               | error   | b would be left in the air                   | ""
start in the air                | [-0.2, -0.3, 0.0155]                         | [-0.2, -0.3, 0.1]                            | warning | b hangs in the air at the start              | ""
start out of reach              | [-0.2, -0.3, 0.0155]                         | [0, -0.95, 0.0155]                           | error   | no robot reaches b: where it lies            | ""
goal out of reach               | [0, 0.4, 0.1155]                             | [0, 0.95, 0.0155]                            | error   | no robot reaches b: its place                | ""
out of reach of who may         | "  steps: [a, b]"                            | "  steps: [a, {place: b, robots: [right]}]"  | error   | no robot that may do it (right) reaches b: where it lies | start: {xyz_m: [-0.2, -0.3,
centre of mass outside the part | goal: {xyz_m: [0, 0.4, 0.1155]}              | "goal: {xyz_m: [0, 0.4, 0.1155]}\n      centre_of_mass_m: [0, 0, 0.2]" | warning | the centre of mass of b is 185.0 mm outside it | centre_of_mass_m
fingers too narrow              | "  steps: [a, b]"                            | "  grips: {opening_m: 0.005}\n  steps: [a, b]" | error   | no fingers span a: its shortest edge is 30.0 mm, and they open to 5.0 mm | size_m: [0.1, 0.03, 0.03]
HOME in a fixture               | size_m: [0.3, 0.3, 0.1], pose: {xyz_m: [0, 0.3, 0.05]} | size_m: [0.3, 0.3, 0.9], pose: {xyz_m: [-0.3, 0.0, 0.45]} | error   | left cannot stand at HOME: left/             | base: {xyz_m: [-0.6, 0, 0]}
HOME in itself                  | base: {xyz_m: [-0.6, 0, 0]}                  | "base: {xyz_m: [-0.6, 0, 0]}\n      home_deg: [0, 90, 0, -170, 0, 20, 45]" | error   | left cannot stand at HOME: left/             | home_deg
bases in each other             | [0.6, 0, 0]                                  | [-0.5, 0, 0]                                 | error   | cannot stand at HOME                         | base: {xyz_m: [-0.6, 0, 0]}
base in a fixture               | [0.6, 0, 0]                                  | [0.6, 0, -0.03]                              | warning | the base of right is 30.0 mm deep in table   | ""
fixtures in each other          | "    - {name: rack"                          | "    - {name: post, size_m: [0.1, 0.1, 0.3], pose: {xyz_m: [0.7, 0.7, 0.13]}}\n    - {name: rack" | warning | fixtures table and post overlap by 20.0 mm   | {name: post
tool frame beside the tool      | base: {xyz_m: [-0.6, 0, 0]}                  | "base: {xyz_m: [-0.6, 0, 0]}\n      frames: {tool: {xyz_m: [0.15, 0, 0.1], rpy_deg: [0, 0, -45]}}" | warning | away from the tool                           | frames: {tool
tool frame across the tool      | base: {xyz_m: [-0.6, 0, 0]}                  | "base: {xyz_m: [-0.6, 0, 0]}\n      frames: {tool: {xyz_m: [0, 0, 0.03], rpy_deg: [45, 90, 0]}}" | warning | does not point out of the tool               | frames: {tool
no such tool frame              | "  steps: [a, b]"                            | "  grips: {frame: hand}\n  steps: [a, b]"    | error   | has no frame 'hand'                          | model: panda
LEGO's timings                  | "pick: {kind: fixed, value_s: 2}"              | "pick: {kind: packaged, skill: pick}"         | warning | packaged times of a LEGO tool with force control (pick | ""
speeds beyond the limits        | {speed_model: joint}                         | {speed_model: l1, speed_rad_s: 5.0}          | warning | speed_rad_s 5 is 2.30 times what a joint can do | ""
""")


def test_a_sound_cell_passes(tmp_path: Path) -> None:
    assert checked(written(tmp_path, CELL)).findings == ()


def planted_change(mistake: str) -> Change:
    old, new, *_ = MISTAKES[mistake]
    return old, new


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_found_at_its_line(mistake: str, tmp_path: Path) -> None:
    old, new, level, words, line = MISTAKES[mistake]
    line = line or new
    file = written(tmp_path, CELL, (old, new))
    report, text = checked(file), file.read_text(encoding="utf-8")
    found = [item for item in report.findings if words in item.message]
    assert found, [item.message for item in report.findings]
    assert all(item.error == (level == "error") for item in found)
    places = [text.splitlines()[report.problem(item).mark.line - 1] for item in found]
    assert any(line.strip() in place for place in places), places
    if level == "warning":
        assert not report.errors


PHYSICAL = ("parts in each other", "part in a fixture")
"""Mistakes that the planner does not look at: it would plan what cannot be."""


@pytest.mark.parametrize(
    "mistake", [k for k, v in MISTAKES.items() if v[2] == "error" and k not in PHYSICAL]
)
def test_what_is_refused_could_not_be_planned(mistake: str, tmp_path: Path) -> None:
    old, new, *_ = MISTAKES[mistake]
    quick = "planning: {", "planning: {shortcut_candidates: 0, attempts: 1, "
    file = written(tmp_path, CELL, (old, new), quick)
    with pytest.raises(TwinError):
        plan_scenario(read_scenario(file)[0], tmp_path)


_EXCEPTION = "{{skill: {}, robot: {}, duration: {{kind: fixed, value_s: 1}}}}"


@pytest.mark.parametrize(
    ("robots", "words"),
    [
        (("left", "right"), []),
        (("left",), [" s in the mean, by right)"]),
        ((), [" s in the mean)"]),
    ],
)
def test_exceptions_of_every_robot_stand_in_for_packaged_times(
    robots: tuple[str, ...], words: list[str], tmp_path: Path
) -> None:
    """As ``twin fit --by robot --apply`` writes them."""
    listed = [_EXCEPTION.format("pick", name) for name in robots]
    packaged = "pick: {kind: packaged, skill: pick}"
    text = CELL.replace("pick: {kind: fixed, value_s: 2}", packaged)
    text += "  skill_overrides: [" + ", ".join(listed) + "]\n"
    said = [item.message for item in checked(written(tmp_path, text)).findings]
    assert len(said) == len(words)
    assert all(map(operator.contains, said, words)), said


def test_many_findings_at_one_place_are_counted(tmp_path: Path) -> None:
    text = (ROOT / "scenarios/construction/wall.yaml").read_text(encoding="utf-8")
    file = written(tmp_path, text, ("growth_m: 0.05", "growth_m: 0.0"))
    messages = [item.message for item in checked(file).errors]
    assert len(messages) == 6
    assert messages[-1].startswith("and ")


def test_all_mistakes_are_found_at_once(tmp_path: Path) -> None:
    names = ("parts in each other", "goal in the air", "speeds beyond the limits")
    file = written(tmp_path, CELL, *map(planted_change, names))
    messages = " ".join(f.message for f in checked(file).findings)
    assert all(MISTAKES[name][3] in messages for name in names)


@pytest.mark.parametrize(
    "file",
    [
        # Its gears are meshes that are cut into convex pieces first.
        pytest.param(file, marks=pytest.mark.nightly)
        if file.stem == "gearbox"
        else file
        for file in SHIPPED
    ],
    ids=lambda file: file.stem,
)
def test_shipped_scenarios_have_no_errors(file: Path) -> None:
    start = time.process_time()
    report = checked(file)
    assert not report.errors, [item.message for item in report.errors]
    # Far more than it takes, and far less than searching for a plan.
    assert time.process_time() - start < 60.0


def test_goals_that_no_arm_is_long_enough_for(tmp_path: Path) -> None:
    text = (ROOT / "scenarios/multi_arm/multi_goal.yaml").read_text(encoding="utf-8")
    goal = "{robot: west, to: {xyz_m: "
    far = goal + "[-0.35, 0.1, 0.21]", goal + "[3, 0, 0.2]"
    (error,) = checked(written(tmp_path, text, far)).errors
    assert "west does not reach (3.00, 0.00, 0.20) m" in error.message


def test_bricks_that_no_robot_reaches(tmp_path: Path) -> None:
    text = (ROOT / "scenarios/lego/cliff.yaml").read_text(encoding="utf-8")
    old = "{xyz_m: [0.44, 0, 1.1145]}, studs: [48, 48]"
    file = written(tmp_path, text, (old, old.replace(" 0,", " 2.0,")))
    report = checked(file)
    assert len(report.errors) >= 6
    assert "step 1" in report.errors[0].message
    lines = file.read_text(encoding="utf-8").splitlines()
    assert "# a" in lines[report.problem(report.errors[0]).mark.line - 1]


OVERLAP = planted_change("parts in each other")


def test_the_command_prints_places_and_draws_the_cell(tmp_path: Path) -> None:
    file = written(tmp_path, CELL, OVERLAP)
    out = tmp_path / "out"
    done = invoke("check", file, "--out", out, code=2)
    assert "own.yaml:19:14: a and b overlap by 20.0 mm" in done.output
    assert (out / "cell.png").stat().st_size > 10_000
    done = invoke("check", file, "--json")
    content = json.loads(done.stdout)
    assert not content["ok"]
    assert content["findings"][0]["line"] == 19
    assert content["findings"][0]["key"] == "assembly.parts.0.start"


def test_a_run_ends_before_planning(tmp_path: Path) -> None:
    file = written(tmp_path, CELL, OVERLAP)
    out = tmp_path / "run"
    done = invoke("run", file, "--out", out, code=2)
    assert "own.yaml:19:14: a and b overlap by 20.0 mm" in done.output
    assert not out.exists()


@pytest.mark.nightly
def test_a_run_keeps_warnings(tmp_path: Path) -> None:
    fast = "speed_model: l1, speed_rad_s: 5.0, shortcut_candidates: 0"
    file = written(tmp_path, CELL, ("speed_model: joint", fast))
    out = tmp_path / "run"
    done = invoke("run", file, "--out", out, "--no-audit", "--no-recording", code=0)
    assert "2.30 times what a joint can do" in done.output
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    (warning,) = summary["warnings"]
    assert "2.30 times what a joint can do" in warning


def test_a_full_pallet_has_left_when_the_next_one_is_filled(tmp_path: Path) -> None:
    """A tray of four, two parts a product, a pallet of one: the second product goes where the first was."""
    line = re.sub(r"    - name: .*\n(      .*\n)+", "", CELL.split("assembly:")[1])
    line = line.replace(
        "  parts:\n  steps: [a, b]\n",
        """\
  sources:
    plate: {kind: tray, pose: {xyz_m: [-0.2, -0.3, 0.0155]}, grid: {counts: [2, 2], pitch_m: [0.06, 0.06]}}
  parts:
    - {name: a, size_m: [0.03, 0.03, 0.03], source: plate, goal: {xyz_m: [0, 0.3, 0.1155]}}
    - {name: b, size_m: [0.03, 0.03, 0.03], source: plate, goal: {xyz_m: [0, 0.3, 0.1465]}}
  steps: [a, b]
  products: {count: 6, places: {counts: [1, 1], pitch_m: [0.1, 0.1]}}
""",
    )
    text = CELL.split("assembly:")[0] + "assembly:" + line
    assert [item.message for item in checked(written(tmp_path, text)).errors] == []
    sunk = "0.3, 0.1465]", "0.3, 0.1365]"
    (found, *_) = checked(written(tmp_path, text, sunk)).errors
    assert "b.1 goes where a.1 is by then" in found.message
