"""Temporary bricks of scenarios: told when they are shut in, refused where asked, and remembered in steps."""

import json
from functools import partial
from pathlib import Path

import pytest
import yaml

import twin
from tests.twin.program import invoke
from tests.twin.scenarios.cells import GP4S, cell
from tests.twin.written import checked, written

FILE = (
    cell(
        "lamp",
        GP4S,
        """\
  kind: lego
  plate: {pose: {xyz_m: [0.44, 0, 1.1145]}}
  rules: {scaffold: true, place_up: false, support: false}
  stock:
    - {name: s2, brick: 2x2, at: [4, 12, 1], station: true}
    - {name: s6, brick: 2x6, at: [4, 24, 1], station: true}
  structure:
    bricks:
      - {name: floor, brick: 2x6, at: [20, 20, 1], turned: true}
      - {name: post1, brick: 2x2, at: [20, 20, 2]}
      - {name: post2, brick: 2x2, at: [20, 20, 3]}
      - {name: lamp, brick: 2x2, at: [24, 20, 3]}
      - {name: roof, brick: 2x6, at: [20, 20, 4], turned: true}
""",
        "{name: table, size_m: [0.6, 1.2, 0.02], pose: {xyz_m: [0.44, 0, 1.1045]}}",
    )
    + "planning: {shortcut_candidates: 0}\n"
)
"""A lamp hangs from a roof over a floor: what carries it as it goes in stays between both."""


_sequence = partial(invoke, "sequence")


@pytest.fixture(scope="module")
def steps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The steps that are found."""
    folder = tmp_path_factory.mktemp("lamp")
    out = folder / "steps.yaml"
    result = _sequence(written(folder, FILE), "-o", out, code=0)
    assert "cannot be taken out again: 'under lamp" in result.output
    assert "is shut in behind 'floor'" in result.output
    return out


def test_what_is_shut_in_is_named_in_rows(tmp_path: Path) -> None:
    rows = json.loads(_sequence(written(tmp_path, FILE), "--json").output)
    behind = {r["name"]: r["shut_in_behind"] for r in rows if "shut_in_behind" in r}
    assert list(behind) == [r["name"] for r in rows if r.get("temporary")]
    assert all(found[:2] == ["floor", "lamp"] for found in behind.values())


@pytest.mark.parametrize("by", ["option", "rule"])
def test_only_helpers_that_come_out_may_be_asked_for(tmp_path: Path, by: str) -> None:
    change = [("scaffold: true", "scaffold: removable")] * (by == "rule")
    options = ["--scaffold", "removable"] * (by == "option")
    result = _sequence(written(tmp_path, FILE, *change), *options, code=2)
    assert "'lamp' (2x2 at [24, 20, 3])" in result.output
    assert "with bricks that stay shut in" in result.output


def test_other_words_for_a_scaffold_are_refused(tmp_path: Path) -> None:
    result = _sequence(written(tmp_path, FILE), "--scaffold", "some", code=2)
    assert "none, any, removable" in result.output.replace("'", "")


def test_a_check_says_what_is_shut_in(tmp_path: Path, steps: Path) -> None:
    for file, key in ((written(tmp_path, FILE), "rules"), (steps, "steps")):
        (found,) = (f for f in checked(file).findings if "shut in" in f.message)
        assert found.at[:2] == ("assembly", key)
        assert not found.error
        assert "'floor'" in found.message or "step 1" in found.message
    asked = steps.read_text().replace("scaffold: true", "scaffold: removable")
    (error,) = checked(written(tmp_path, asked, name="asked.yaml")).errors
    assert "cannot be taken out again" in error.message


def test_a_run_of_steps_remembers_who_helps(tmp_path: Path, steps: Path) -> None:
    done = twin.run(twin.load(steps), out=tmp_path / "run", recording=False)
    audit = done.summary["audit"]
    listed = yaml.safe_load(steps.read_text())["assembly"]["steps"]
    assert len(audit["helpers"]) == sum(s.get("temporary", False) for s in listed) == 1
    assert audit["violations"] == []


def test_steps_are_sequenced_anew_with_their_helpers(steps: Path) -> None:
    rows = json.loads(_sequence(steps, "--json").output)
    assert sum(row.get("temporary", False) for row in rows) == 1
    assert len(rows) == 6
