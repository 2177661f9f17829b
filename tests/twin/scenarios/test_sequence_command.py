"""``twin sequence``, and scenarios that give a structure in place of steps."""

import json
from functools import partial
from pathlib import Path

import pytest

from planning.lego.sequencing.sequencing import sequence_structure
from tests.twin.program import invoke
from tests.twin.scenarios.cells import GP4S, cell
from tests.twin.written import refusal, written
from twin.document.validation import InvalidScenarioError
from twin.kinds.lego.kind import build_lego, build_structure
from twin.kinds.lego.section import LegoSection
from twin.reading.scenario_file import load_scenario

HEAD = cell(
    "small",
    GP4S,
    """\
  kind: lego
  plate: {pose: {xyz_m: [0.44, 0, 1.1145]}}
  stock:
    - {name: s1, brick: 2x4, at: [2, 2, 1]}
    - {name: s2, brick: 2x4, at: [2, 10, 1]}
    - {name: s3, brick: 2x2, at: [2, 18, 1]}
""",
    "{name: table, size_m: [0.6, 1.2, 0.02], pose: {xyz_m: [0.44, 0, 1.1045]}}",
)

TOWER = """\
  structure:
    origin: [20, 20]
    layers:
      - |
        AA..
        AA..
        AA..
        AA..
      - |
        ....
        ....
        AAAA
        AAAA
"""


def write(folder: Path, structure: str, head: str = HEAD) -> Path:
    return written(folder, head + structure)


run = partial(invoke, "sequence")


def test_the_sequence_is_printed_with_reasons(tmp_path: Path) -> None:
    result = run(write(tmp_path, TOWER), code=0)
    assert "A1" in result.output
    assert "the structure bears the" in result.output
    assert "2 steps: 2 plain" in result.output


def test_json_has_a_row_a_step(tmp_path: Path) -> None:
    result = run(write(tmp_path, TOWER), "--json")
    rows = json.loads(result.output)
    assert [(r["step"], r["brick"], r["at"], r["kind"]) for r in rows] == [
        (1, "2x4", [20, 20, 1], "plain"),
        (2, "2x4", [20, 20, 2], "plain"),
    ]
    assert rows[1]["turned"]
    assert rows[0]["press"] == rows[0]["presses"][0]


@pytest.mark.nightly
def test_the_written_scenario_builds_the_same_with_steps(tmp_path: Path) -> None:
    """Steps with all alternatives come back as they were found."""
    source = Path(__file__).parents[3] / "scenarios/lego/faucet.yaml"
    out = tmp_path / "steps.yaml"
    run(source, "-o", out, code=0)
    lego, again = load_scenario(source).assembly, load_scenario(out).assembly
    assert isinstance(lego, LegoSection)
    assert isinstance(again, LegoSection)
    structure = build_structure(lego)
    assert structure is not None
    scaffold = build_lego(lego).scaffold
    found = sequence_structure(structure, scaffold=scaffold)
    assert again.structure is None
    steps = build_lego(again).steps
    for step, expected in zip(steps, found.steps, strict=True):
        how = expected.cell, expected.up, expected.attack
        assert (step.cell, step.up, step.attack) == how
        assert step.press == expected.press
        assert step.support == expected.support
        assert (step.presses or (step.press,)) == expected.presses
        alone = () if step.support is None else (step.support,)
        assert (step.supports or alone) == expected.supports


def test_steps_are_sequenced_anew(tmp_path: Path) -> None:
    steps = "  steps:\n    - {brick: 2x4, at: [20, 20, 1]}\n"
    steps += "    - {brick: 2x2, at: [20, 21, 2]}\n"
    result = run(write(tmp_path, steps), "--json")
    assert [r["name"] for r in json.loads(result.output)] == ["step 1", "step 2"]


def test_an_unstable_structure_ends_with_2_and_a_reason(tmp_path: Path) -> None:
    """A brick on the far end of a beam on one stud, with nowhere to hold it: too low for a tool."""
    head = HEAD + "    - {name: s4, brick: 1x1, at: [2, 22, 1]}\n"
    head += "    - {name: s5, brick: 1x8, at: [2, 26, 1]}\n"
    head += "    - {name: s6, brick: 1x2, at: [6, 22, 1]}\n"
    structure = """\
  structure:
    origin: [20, 20]
    layers:
      - "........\\n.......A\\n"
      - "........\\nBBBBBBBB\\n"
      - "........\\nCC......\\n"
"""
    result = run(write(tmp_path, structure, head), code=2)
    assert "'C3' (1x2 at [20, 20, 3])" in result.output
    assert "gives way" in result.output


@pytest.mark.parametrize(
    ("old", "new", "place", "message"),
    [
        ("        AAAA\n        AAAA\n", "        AAAA\n        AAA.\n", "27:9", "no rectangle"),
        ("        AAAA\n        AAAA\n", "        ..AA\n        ..AA\n", "27:11", "floats"),
        ("        AAAA\n        AAAA\n", "        AAA.\n        AAA.\n", "27:9", "stock has 0"),
        ("        AAAA\n        AAAA\n", "        AAAA\n        AAA\n", "28:9", "3 characters"),
        ("origin: [20, 20]", "origin: [2, 2]", "20:9", "goes where s1 of the stock"),
        ("origin: [20, 20]", "origin: [47, 20]", "20:9", "beyond the plate"),
        ("    origin: [20, 20]\n", "", "17:5", "layers need an 'origin'"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_told_with_its_place(
    tmp_path: Path, old: str, new: str, place: str, message: str
) -> None:
    said = str(refusal(tmp_path, HEAD + TOWER, (old, new)))
    assert message in said
    assert f"own.yaml:{place}: " in said


def test_a_structure_may_have_a_file_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "tower.yaml").write_text(
        "\n".join(line[4:] for line in TOWER.splitlines()[1:]) + "\n"
    )
    path = write(tmp_path, "  structure: {file: tower.yaml}\n")
    lego = load_scenario(path).assembly
    inline = load_scenario(write(tmp_path, TOWER)).assembly
    assert lego == inline
    (tmp_path / "tower.yaml").write_text(
        "origin: [20, 20]\nlayers:\n  - |\n    AB\n    AA\n"
    )
    path = write(tmp_path, "  structure: {file: tower.yaml}\n")
    with pytest.raises(InvalidScenarioError, match=r"tower\.yaml:4:5: .*no rectangle"):
        load_scenario(path)
    path = write(tmp_path, "  structure: {file: missing.yaml}\n")
    with pytest.raises(InvalidScenarioError, match=r"own\.yaml:16:.*cannot be read"):
        load_scenario(path)


def test_steps_and_structure_exclude_each_other(tmp_path: Path) -> None:
    steps = "  steps:\n    - {brick: 2x4, at: [20, 20, 1]}\n"
    for text in (steps + TOWER, ""):
        with pytest.raises(InvalidScenarioError, match="'steps' or 'structure'"):
            load_scenario(write(tmp_path, text))
