"""What cannot be built ends in an error that names the step, the brick and the reason.

The scenarios are the cliff with something in it that cannot be.
"""

import time
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from planning.errors import InfeasibleStepError
from planning.lego.sequencing.stable_steps import stable_steps
from tests.assembly_section import assembly_section
from tests.planted import rows
from tests.twin.program import invoke
from tests.twin.written import written
from twin.kinds.lego.kind import build_lego
from twin.kinds.lego.section import LegoSection
from twin.reading.scenario_file import load_scenario
from twin.scenario.schema import scenario_schema

ROOT = Path(__file__).parents[3]
CLIFF: dict[str, Any] = yaml.safe_load(
    (ROOT / "scenarios" / "lego" / "cliff.yaml").read_text(encoding="utf-8")
)
Edit = Callable[[dict[str, Any]], None]
FAR_BRICK = (
    "place-down of 2x4 at [23, 500, 1] .. no robot reaches where it goes"
    " .. left: approach is out of reach; right: approach is out of reach"
)
SECONDS = 20.0
"""Far more than is needed, as tests share processors; a search that is not cut short takes longer."""


def section_of(file: Path) -> LegoSection:
    return assembly_section(load_scenario(file), LegoSection)


def write(folder: Path, *edits: Edit) -> Path:
    content = deepcopy(CLIFF)
    for edit in edits:
        edit(content)
    return written(folder, yaml.safe_dump(content, sort_keys=False))


def bricks_as_structure(content: dict[str, Any]) -> None:
    """Show what is to be built in place of the steps, bricks a to k from the plate up."""
    steps = content["assembly"].pop("steps")
    content["assembly"]["structure"] = {
        "bricks": [
            {"name": name, "brick": step["brick"], "at": step["at"]}
            for name, step in zip("abcdefghijk", steps, strict=True)
        ]
    }


def rules(**values: Any) -> Edit:
    def edit(content: dict[str, Any]) -> None:
        content["assembly"]["rules"] = values

    return edit


def long_plate(content: dict[str, Any]) -> None:
    """Let the plate go on to y = -2.2 m and further, with its near end where it was."""
    plate = content["assembly"]["plate"]
    plate["studs"] = [48, 600]
    plate["pose"]["xyz_m"][1] += (600 - 48) / 2 * 0.008


def far_brick(content: dict[str, Any]) -> None:
    long_plate(content)
    assembly = content["assembly"]
    at = [23, 500, 1]
    if "steps" in assembly:
        del assembly["steps"][3:]
        assembly["steps"].append({"brick": "2x4", "at": at})
    else:
        del assembly["structure"]["bricks"][3:]
        assembly["structure"]["bricks"].append(
            {"name": "far", "brick": "2x4", "at": at}
        )


def far_stock(content: dict[str, Any]) -> None:
    long_plate(content)
    for item in content["assembly"]["stock"]:
        if item["brick"] == "2x6":
            item["at"][1] += 400


def floating(content: dict[str, Any]) -> None:
    assembly = content["assembly"]
    assembly["stock"].append({"name": "one_more", "brick": "2x4", "at": [14, 40, 1]})
    at = [30, 15, 4]
    if "steps" in assembly:
        assembly["steps"].append({"brick": "2x4", "at": at})
    else:
        assembly["structure"]["bricks"].append({"name": "x", "brick": "2x4", "at": at})


def no_support(content: dict[str, Any]) -> None:
    for step in content["assembly"]["steps"]:
        if step.get("place") != "up":
            step.pop("support", None)


def one_robot(content: dict[str, Any]) -> None:
    del content["cell"]["robots"][1:]


def arm_in_the_air(content: dict[str, Any]) -> None:
    bricks = [{"brick": "2x4", "at": [23, 10 + 3 * k, 1 + k]} for k in range(12)]
    content["assembly"]["structure"] = {"bricks": bricks}
    del content["assembly"]["steps"]
    content["assembly"]["stock"][2]["station"] = True


def on_the_edge(content: dict[str, Any]) -> None:
    content["assembly"]["steps"][7]["press"] = {"side": 1, "offset": 2}


EDITS: dict[str, Edit] = {
    "structure": bricks_as_structure,
    "far brick": far_brick,
    "far stock": far_stock,
    "floating": floating,
    "no support": no_support,
    "supports forbidden": rules(support=False),
    "from below forbidden": rules(place_up=False),
    "one robot": one_robot,
    "arm in the air": arm_in_the_air,
    "on the edge": on_the_edge,
}

# Where the order is sought, bricks of one layer come before the tower on one of them. The hint at
# supports is right: with the first one proposed for each step it can be built.
REFUSED = rows(r"""
commands              | edits                            | says
run                   | far brick                        | FAR BRICK .. step 4 (
sequence              | far brick                        | FAR BRICK .. step 2 (
run sequence          | structure, far brick             | FAR BRICK .. step 2 (
run sequence          | far stock                        | step 1 (place-down of 2x6 at [23, 14, 1]) .. no robot reaches left_2x6 or right_2x6 of the stock
run sequence          | structure, far stock             | step 1 (place-down of 2x6 at [23, 14, 1]) .. no robot reaches left_2x6 or right_2x6 of the stock
run sequence validate | floating                         | step 12 would float .. FILE:
run sequence validate | structure, floating              | brick x (2x4) floats: it is not joined to the plate .. FILE:
run                   | no support                       | step 9 (place-down of 2x4 at [23, 20, 9]): the structure gives way under the press of 15.0 N from above (it bears 11.5 N) .. the 2x4 of step 7 needs 1.3 .. step 10 ( .. SUPPORT8 .. SUPPORT9
run                   | no support, supports forbidden   | step 9 ( .. the structure gives way under the press .. a support is not allowed
validate              | supports forbidden               | step 9 has a support, which 'rules' forbid .. FILE:
validate              | from below forbidden             | step 11 places from below, which 'rules' forbid
run sequence          | structure, supports forbidden    | no order of assembly exists: of these 3 bricks none can go in after the others .. 'i' (2x4 at [23, 20, 9]): pressed from above with 15.0 N the structure gives way: it bears 11.5 N at most, wherever it is pressed; brick 'h' is in the way below it .. 'support'
run sequence          | structure, from below forbidden  | 'k' (2x2 at [23, 24, 9]): there is nothing below it to press it onto from above; placing from below is not allowed .. what would help, switched on in the rules: 'place_up' or 'scaffold' (8 temporary
run sequence          | structure, one robot             | this brick cannot go in .. (2x2 at [23, 24, 9]) .. a single robot can neither support nor hand over
run                   | one robot                        | step 9 (place-down of 2x4 at [23, 20, 9]): it needs a support by another robot .. step 11 (place-up of 2x2 at [23, 24, 9]): it needs a handover and a support .. there is only left
run sequence          | arm in the air                   | the finished structure does not stand .. (2x4 at [23, 13, 2]) needs .. times the friction
run                   | on the edge                      | step 8 (place-down of 2x4 at [23, 18, 8]) .. no forces of its knobs keep the 2x4 of step 8 in balance .. it would bear press {side: 1, offset: 0}
""")


def meant(words: str, path: Path) -> str:
    """Return what is to be said, with the supports of the cliff's own file."""
    for k, step in enumerate(CLIFF["assembly"]["steps"]):
        words = words.replace(f"SUPPORT{k}", str(step.get("support")).replace("'", ""))
    return words.replace("FILE", str(path)).replace("FAR BRICK", FAR_BRICK)


@pytest.mark.parametrize(
    ("command", "edits", "words"),
    [
        (command, edits, words)
        for commands, edits, words in REFUSED
        for command in commands.split()
    ],
)
def test_what_cannot_be_built_is_refused_in_words(
    command: str, edits: str, words: str, tmp_path: Path
) -> None:
    path = write(tmp_path, *(EDITS[name] for name in edits.split(", ")))
    options = ["--out", str(tmp_path / "run")] if command == "run" else []
    started = time.monotonic()
    result = invoke(command, path, *options)
    assert time.monotonic() - started < SECONDS
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.stderr
    for part in meant(words, path).split(" .. "):
        assert part in result.stderr, result.stderr
    if edits == "supports forbidden":
        assert "step 11" not in result.stderr  # that of a place-up belongs to it
    if "far brick" in edits:
        assert not (tmp_path / "run").exists()


def test_steps_are_checked_unless_the_rules_say_otherwise(tmp_path: Path) -> None:
    unchecked = write(tmp_path, on_the_edge, rules(check_steps=False))
    assert section_of(unchecked).rules.check_steps is False
    with pytest.raises(InfeasibleStepError, match="step 8"):
        stable_steps(build_lego(section_of(write(tmp_path, on_the_edge))))


def test_grips_left_to_the_planner_are_those_that_the_structure_bears(
    tmp_path: Path,
) -> None:
    def free(content: dict[str, Any]) -> None:
        for step in content["assembly"]["steps"][:8]:
            del step["press"]

    given = build_lego(section_of(write(tmp_path, free)))
    borne = stable_steps(given)
    assert borne.steps[0] == given.steps[0]  # on the plate, every grip will do
    narrowed = borne.steps[6]
    assert narrowed.press == narrowed.presses[0]
    assert 0 < len(narrowed.presses) < 8
    for press in narrowed.presses:
        one = replace(narrowed, presses=(press,))
        steps = (*borne.steps[:6], one, *borne.steps[7:])
        assert stable_steps(replace(borne, steps=steps)).steps == steps
    full = build_lego(section_of(write(tmp_path)))
    assert stable_steps(full) == full


def test_editors_know_that_a_structure_may_have_a_file() -> None:
    options = scenario_schema()["$defs"]["LegoSection"]["properties"]["structure"][
        "anyOf"
    ]
    assert [o for o in options if o.get("required") == ["file"]]
    assert {"$ref": "#/$defs/StructureSection"} in options
