"""A scenario file is refused for what is wrong with it, all at once, each at its place."""

import json
import re
from pathlib import Path

import pytest

from tests.assembly_section import assembly_section
from tests.planted import planted
from tests.twin.twin_toys import toy_cell
from tests.twin.written import loaded, refusal
from twin.document.validation import InvalidScenarioError
from twin.kinds.lego.section import LegoSection
from twin.kinds.parts.section import PartsSection
from twin.reading.scenario_file import load_scenario
from twin.scenario.manifest import (
    MANIFEST,
    read_manifest,
    scenario_sha256,
    write_manifest,
)
from twin.scenario.schema import scenario_schema
from twin.scenario.sections.scenario import resolve_scenario, restore_scenario

ROOT = Path(__file__).parents[3]

GOOD = """\
version: 1
name: tiny
cell:
  robots:
    - name: left
      model: gp4
      base: {xyz_m: [0, 0, 0.9246]}
  fixtures:
    - {name: table, size_m: [1, 1, 0.1], pose: {xyz_m: [0, 0, 0]}}
assembly:
  kind: lego
  plate: {pose: {xyz_m: [0.4, 0, 1.1]}}
  stock:
    - {name: b1, brick: 2x4, at: [0, 0, 1]}
    - {name: b2, brick: 2x4, at: [4, 0, 1]}
    - {name: b3, brick: 1x2, at: [8, 0, 1], fixed: true}
  steps:
    - {brick: 2x4, at: [24, 24, 1], press: {side: 1, offset: 1}}
    - {brick: 2x4, at: [24, 26, 2]}
execution:
  skills:
    pick: {kind: lognormal, median_s: 1e1, p95_s: 12}
    handover: {kind: empirical, csv: handover.csv}
  stalls: {count_per_robot: 2}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the measured times that the good file names."""
    (tmp_path / "handover.csv").write_text("duration_s\n8.5\n9\n")
    return tmp_path


def test_a_good_file_loads_with_defaults(folder: Path) -> None:
    scenario = loaded(folder, GOOD)
    assert scenario.seed == 0
    assert scenario.cell.clearance.robot_robot_m == 0.001
    assembly = assembly_section(scenario, LegoSection)
    assert assembly.plate.studs == (48, 48)
    assert assembly.twist_deg.place_down == 16.0
    assert scenario.execution.stalls.duration_s == (1.0, 20.0)
    assert scenario.execution.skills["pick"].median_s == 10.0  # type: ignore[union-attr]


def test_the_resolved_scenario_reads_back_and_names_itself(folder: Path) -> None:
    scenario = loaded(folder, GOOD)
    assert restore_scenario(resolve_scenario(scenario)) == scenario
    other = loaded(folder, GOOD, ("[4, 0, 1]", "[4, 1, 1]"))
    assert resolve_scenario(other) != resolve_scenario(scenario)
    spelled = loaded(folder, GOOD + "seed: 0\n")
    assert resolve_scenario(spelled) == resolve_scenario(scenario)


# What is changed in the good file, the text at the place of the one problem, and its words.
ONE_PROBLEM = planted(r"""
mistake                                      | old                           | new                                          | at               | says
misspelt key                                 | "      model:"                | "      modle:"                               | modle: gp4       | did you mean 'model'?
wrong unit                                   | base: {xyz_m:                 | base: {xyz_mm:                               | xyz_mm: [0, 0,   | in metres, as 'xyz_m'
unknown key                                  | median_s: 1e1                 | median_s: 1e1, wobble: 2                     | wobble: 2, p95   | 'wobble'
missing key                                  | "      model: gp4\n"          | ""                                           | name: left       | key 'model' is missing
version                                      | version: 1                    | version: 2                                   | 2                | 1 expected, not 2
kind                                         | kind: lego                    | kind: lgo                                    | lgo              | lego
unknown model                                | model: gp4                    | model: gp5                                   | gp5              | did you mean 'gp4'?
missing urdf                                 | model: gp4                    | model: no.urdf                               | no.urdf          | no.urdf
home length                                  | base: {xyz_m: [0, 0, 0.9246]} | "base: {xyz_m: [0, 0, 0.9246]}\n      home_deg: [1, 2]" | [1, 2]           | 2 values for the 6 joints
two rotations                                | {xyz_m: [0, 0, 0]}            | {xyz_m: [0, 0, 0], rpy_deg: [0, 0, 0], quat_wxyz: [1, 0, 0, 0]} | {xyz_m: [0, 0,   | not both
zero quaternion                              | {xyz_m: [0, 0, 0]}            | {xyz_m: [0, 0, 0], quat_wxyz: [0, 0, 0, 0]}  | {xyz_m: [0, 0,   | must not be zero
text for a number                            | [1, 1, 0.1]                   | [1, on, 0.1]                                 | on, 0.1], pose   | a number expected
neither a number nor a list                  | "      model: gp4\n"          | "      model: gp4\n      limits: {velocity: fast}\n" | fast}            | velocity: a list [..] or a number expected, not 'fast'
a number out of bounds where a list may stand | "      model: gp4\n"          | "      model: gp4\n      limits: {velocity: 0}\n" | 0}               | velocity: must be at least 0.001, not 0
an entry where a number may stand            | "      model: gp4\n"          | "      model: gp4\n      limits: {velocity: [1, fast]}\n" | fast]            | velocity[1]: a number expected, not 'fast'
not finite                                   | [1, 1, 0.1]                   | [1, .nan, 0.1]                               | .nan, 0.1], po   | finite number expected
flat box                                     | [1, 1, 0.1]                   | [1, 1, 0]                                    | 0], pose: {xyz   | must be at least 0.0001, not 0
two numbers                                  | [1, 1, 0.1]                   | [1, 1]                                       | "[1, 1], pose: " | 3 entries expected, not 2
number for text                              | b1, brick: 2x4                | b1, brick: 24                                | 24, at: [0, 0,   | quotes, "24"
half a stud                                  | [0, 0, 1]}                    | [0, 0.5, 1]}                                 | 0.5, 1]}         | a whole number expected
name                                         | name: b1                      | name: b/1                                    | b/1, brick: 2x   | is no name
name taken                                   | name: b2                      | name: b1                                     | name: b1, bric   | 'b1' of a brick in stock is already taken by a brick in stock at
name of fixture                              | name: b2                      | name: table                                  | name: table, b   | is already taken
name of robot                                | name: b2                      | name: left                                   | name: left, br   | is that of a robot
brick type                                   | b1, brick: 2x4                | b1, brick: 2x5                               | 2x5, at: [0, 0   | unknown brick type
same place                                   | [4, 0, 1]                     | [1, 3, 1]                                    | [1, 3, 1]}       | b2 stands where b1 already
off the plate                                | [4, 0, 1]                     | [47, 0, 1]                                   | [47, 0, 1]}      | beyond the plate of 48 x 48
under the plate                              | [4, 0, 1]                     | [4, 0, 0]                                    | [4, 0, 0]}       | the lowest layer is 1
stock floats                                 | [8, 0, 1]                     | [8, 0, 2]                                    | [8, 0, 2], fix   | b3 floats
fixed station                                | fixed: true                   | fixed: true, station: true                   | {name: b3, bri   | not both
goal taken                                   | [24, 26, 2]                   | [24, 27, 1]                                  | [24, 27, 1]}     | where step 1 already is
goal on stock                                | [24, 26, 2]                   | [8, 1, 1]                                    | [8, 1, 1]}       | where b3 already is
goal floats                                  | [24, 26, 2]                   | [24, 28, 2]                                  | [24, 28, 2]}     | step 2 would float
nothing above                                | at: [24, 26, 2]               | at: [24, 26, 2], place: up, press_cell: {at: [24, 26, 1]}, support: {at: [24, 30, 3], orientation: 0} | [24, 26, 2], p   | no brick placed before is above it
support taken                                | [24, 26, 2]}                  | [24, 26, 2], support: {at: [24, 27, 1], orientation: 0}} | [24, 27, 1], o   | the support goes where step 1 is
press offset                                 | offset: 1                     | offset: 3                                    | 3}}              | an offset of at most 2 fits
stock of a step                              | at: [24, 26, 2]               | at: [24, 26, 2], stock: b9                   | b9}              | unknown stock brick 'b9'
fixed stock                                  | {brick: 2x4, at: [24, 26, 2]  | {brick: 1x2, at: [24, 26, 2], stock: b3      | b3}              | b3 is fixed
wrong stock                                  | {brick: 2x4, at: [24, 26, 2]  | {brick: 2x4, at: [24, 26, 2], stock: b3      | b3}              | b3 is a 1x2, step 2 needs a 2x4
supply                                       | {brick: 2x4, at: [24, 26, 2]} | "{brick: 2x4, at: [24, 26, 2]}\n    - {brick: 2x4, at: [30, 26, 1]}" | "2x4, at: [30, " | step 3 is the 3rd to need a 2x4, but the stock has 2
negative duration                            | median_s: 1e1                 | median_s: -1                                 | -1, p95_s: 12}   | greater than 0
percentile                                   | p95_s: 12                     | p95_s: 9                                     | {kind: lognorm   | p95_s must not be less
distribution                                 | kind: lognormal               | kind: logn                                   | logn, m          | mean 'lognormal'?
no distribution                              | "kind: lognormal, "           | ""                                           | {median_s: 1e1   | key 'kind' is missing
skill                                        | "    pick:"                   | "    pikc:"                                  | pikc: {kind: l   | did you mean 'pick'?
missing csv                                  | csv: handover.csv             | csv: no.csv                                  | no.csv}          | no such file
csv column                                   | csv: handover.csv             | csv: handover.csv, column: time              | "handover.csv, " | no column 'time' (valid: duration_s)
""")


@pytest.mark.parametrize("case", ONE_PROBLEM, ids=lambda c: c.replace(" ", "-"))
def test_one_mistake_one_message_at_its_place(case: str, folder: Path) -> None:
    old, new, at, words = ONE_PROBLEM[case]
    assert GOOD.count(old) == 1
    found = refusal(folder, GOOD, (old, new))
    (problem,) = found.problems
    written = found.lines[problem.mark.line - 1][problem.mark.column - 1 :]
    assert written.startswith(at)
    assert words in problem.message


def test_all_mistakes_are_reported_at_once(folder: Path) -> None:
    found = refusal(
        folder,
        GOOD + "cell: {}\n",
        ("version: 1", "version: 3"),
        ("model: gp4", "modle: gp4"),
        ("[1, 1, 0.1]", "[1, 1, -1]"),
        ("p95_s", "p95"),
    )
    assert [problem.mark.line for problem in found.problems] == [1, 6, 9, 22, 25]


def test_places_of_bricks_taken_from_named_stock_are_free_again(folder: Path) -> None:
    named = "press: {side: 1, offset: 1}}", "stock: b1}"
    there = "{brick: 2x4, at: [24, 26, 2]}", "{brick: 2x4, at: [0, 1, 1]}"
    assembly = assembly_section(loaded(folder, GOOD, named, there), LegoSection)
    assert assembly.steps[1].at == (0, 1, 1)


def test_a_station_never_runs_out(folder: Path) -> None:
    station = "[4, 0, 1]}", "[4, 0, 1], station: true}"
    step = "    - {brick: 2x4, at: [24, 26, 2]}\n"
    steps = "".join(step.replace("2]", f"{z}]") for z in range(2, 9))
    fed = loaded(folder, GOOD, station, (step, steps))
    assert len(assembly_section(fed, LegoSection).steps) == 8


PARTS = """\
version: 1
name: all
cell: {robots: [{name: arm, model: ur5e}]}
assembly:
  kind: assembly
  ORDER
  parts:
    - {name: a, size_m: [0.04, 0.04, 0.04], start: {xyz_m: [0.5, 0, 0.02]}, goal: {xyz_m: [0, 0.5, 0.02]}}
    - {name: stays, size_m: [0.04, 0.04, 0.04], start: {xyz_m: [0.5, 0.2, 0.02]}}
    - {name: b, size_m: [0.04, 0.04, 0.04], start: {xyz_m: [0.4, 0, 0.02]}, goal: {xyz_m: [0, 0.5, 0.06]}}
"""


def test_where_an_order_is_found_all_parts_with_a_goal_are_put_in_place(
    folder: Path,
) -> None:
    find = "ORDER", "order: find"
    assembly = assembly_section(loaded(folder, PARTS, find), PartsSection)
    assert assembly.placed == ("a", "b")
    said = str(refusal(folder, PARTS, ("ORDER", "order: listed")))
    assert re.search(r"'steps' is missing: .* 'order: find'", said)
    none = ", goal: {xyz_m: [0, 0.5, 0.02]}", ", goal: {xyz_m: [0, 0.5, 0.06]}"
    said = str(refusal(folder, PARTS, find, *((goal, "") for goal in none)))
    assert "no part has a 'goal'" in said


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "the file is empty"),
        (b"- 1\n- 2\n", "a mapping (key: value) expected, not a list"),
        (b"hello\n", "a mapping (key: value) expected"),
        (b"a: [\n", "not valid YAML"),
        (b"\xff\xfe\x00", "not a UTF-8 text file"),
        (b"PK\x03\x04 zip \x00\x01", "not a text file"),
    ],
)
def test_files_that_are_no_scenario(content: bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / "file.yaml"
    path.write_bytes(content)
    with pytest.raises(InvalidScenarioError, match=re.escape(words)) as caught:
        load_scenario(path)
    assert str(caught.value).startswith(f"{path}:")


def test_a_missing_file_and_a_folder_say_so(tmp_path: Path) -> None:
    with pytest.raises(InvalidScenarioError, match="no such file"):
        load_scenario(tmp_path / "none.yaml")
    with pytest.raises(InvalidScenarioError, match="this is a folder"):
        load_scenario(tmp_path)


def test_the_report_shows_the_line_with_a_caret_and_cuts_long_ones_around_it(
    folder: Path,
) -> None:
    report = refusal(folder, GOOD, ("p95_s: 12", "p95: 12")).report()
    head, line, caret = report.splitlines()
    assert head.startswith(f"{folder / 'own.yaml'}:22:44: unknown key 'p95'")
    assert line[caret.index("^") :].startswith("p95: 12")
    long = GOOD + "description: {" + "x" * 300 + ": 1, y: 2}\n"
    report = refusal(folder, long).report()
    assert all(len(line) < 130 for line in report.splitlines()[1:])


def test_the_committed_schema_is_current() -> None:
    committed = json.loads(
        (ROOT / "twin" / "scenario" / "scenario.schema.json").read_text()
    )
    assert committed == scenario_schema(), (
        "run: twin schema > twin/scenario/scenario.schema.json"
    )


CLIFF = Path(__file__).parents[3] / "scenarios/lego/cliff.yaml"


def test_the_manifest_says_what_is_needed_to_repeat_a_run(tmp_path: Path) -> None:
    scenario = load_scenario(CLIFF)
    write_manifest(tmp_path, scenario, toy_cell((2, 3)), tmp_path, note="more")
    manifest = json.loads((tmp_path / MANIFEST).read_text())
    assert read_manifest(tmp_path, "run") == (scenario, manifest)
    assert set(manifest) == {
        "note",
        "scenario",
        "scenario_sha256",
        "seed",
        "base",
        "versions",
        "files",
        "robots",
    }
    assert scenario_sha256({"a": 1, "b": 2}) == scenario_sha256({"b": 2, "a": 1})
    assert manifest["seed"] == scenario.seed
    assert manifest["versions"]["numpy"]
    assert manifest["robots"][1] == {
        "name": "robot_1",
        "model": "toy",
        "urdf": "toy.urdf",
        "sha256": None,
        "base": {"xyz": [1.0, 0.0, 0.0], "quat_wxyz": [1.0, 0.0, 0.0, 0.0]},
        "joints": ["joint_0", "joint_1", "joint_2"],
        "tool": {
            "last_joint_T_flange": {
                "xyz": [0.1, 0.0, 0.0],
                "quat_wxyz": [1.0, 0.0, 0.0, 0.0],
            },
            "flange_T_frame": {
                "tool": {"xyz": [0.0, 0.0, 0.05], "quat_wxyz": [1.0, 0.0, 0.0, 0.0]}
            },
        },
    }


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "name: b2",
            "name: table",
            "of a brick in stock is already taken by a fixture",
        ),
        ("name: b3", "name: b1", "of a brick in stock is already taken by a brick in"),
        ("name: b2", "name: left", "is that of a robot"),
    ],
)
def test_a_name_that_is_taken_says_by_what_and_where(
    folder: Path, old: str, new: str, words: str
) -> None:
    """Kind, line and column of both; the place of the first one is that of its name in the file."""
    path = folder / "tiny.yaml"
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(InvalidScenarioError) as caught:
        load_scenario(path)
    (problem,) = caught.value.problems
    assert words in problem.message
    place = re.search(r" at (\d+):(\d+)$", problem.message)
    assert place is not None
    line, column = int(place[1]), int(place[2])
    text = path.read_text().splitlines()
    assert new in text[problem.mark.line - 1]
    assert line < problem.mark.line
    assert text[line - 1][column - 1 :].startswith("name: ")
