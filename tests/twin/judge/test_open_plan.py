"""Files that are no open plan are refused, with the place of what is wrong and the valid choices."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.twin.judge.judged import filed, yard
from tests.twin.program import invoke
from twin.document.validation import InvalidScenarioError
from twin.judge.open_plan import FORMAT, read_open_plan

WRONG: dict[str, tuple[tuple[str | int, ...], Any, tuple[str, ...]]] = {
    "version": (("version",), 2, ("version", "1")),
    "robot": (("robots", "wets"), {"joints": ["a"]}, ("wets", "west, east")),
    "joints": (
        ("robots", "west", "joints"),
        ["slew", "trolley", "hoist", "yaw"],
        ("slew, trolley, hoist, hook_yaw",),
    ),
    "key": (("robots", "west", "motions", 1, "when"), 1, ("unknown key 'when'",)),
    "text for a number": (
        ("robots", "west", "motions", 1, "t_s", 0),
        "two",
        ("robots.west.motions[1].t_s[0]", "a number expected"),
    ),
    "times that fall": (
        ("robots", "west", "motions", 1, "t_s", 1),
        1.0,
        ("robots.west.motions[1].t_s[1]", "1 s comes before 2 s"),
    ),
    "a row too few": (
        ("robots", "west", "motions", 1, "q"),
        [[0, 2, 0, 0]],
        ("has 1 rows, and t_s has 3",),
    ),
    "a joint too few": (
        ("robots", "west", "motions", 1, "q", 0),
        [0, 2, 0],
        ("has 3 values, and the robot has 4 joints",),
    ),
    "object": (
        ("robots", "west", "motions", 1, "events", 0, "take"),
        "lowr",
        ("unknown object 'lowr'; did you mean 'lower'? (valid: lower, upper)",),
    ),
    "two verbs": (
        ("robots", "west", "motions", 1, "events", 0, "put"),
        "lower",
        ("exactly one of take, put, give, appear, leave, not take and put",),
    ),
    "give to nobody": (
        ("robots", "west", "motions", 1, "events", 0),
        {"t_s": 4.5, "give": "lower"},
        ("give and to belong together",),
    ),
    "event outside": (
        ("robots", "west", "motions", 1, "events", 0, "t_s"),
        9.0,
        ("9 s is not within its motion, from 2 s to 7 s",),
    ),
    "wait for nobody": (
        ("robots", "east", "motions", 2, "after"),
        ["west swings outt"],
        ("unknown motion 'west swings outt'; did you mean 'west swings out'?",),
    ),
    "id twice": (
        ("robots", "east", "motions", 2, "id"),
        "west picks",
        ("is the id of another motion",),
    ),
    "machine": (("machines",), {"belt": []}, ("the scenario has no machines",)),
    "joint value": (
        ("robots", "west", "motions", 1, "q", 1, 2),
        1e5,
        ("must be at most 100",),
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_told_with_its_place(name: str, tmp_path: Path) -> None:
    path, value, words = WRONG[name]
    content = yard(tmp_path)
    holder: Any = content
    for key in path[:-1]:
        holder = holder[key]
    holder[path[-1]] = value
    file = filed(content, tmp_path)
    said = " ".join(invoke("judge", file, code=2).stderr.split())
    assert f"{file}:" in said
    for word in words:
        assert word in said
    row = int(said.split(f"{file}:")[1].split(":")[0])
    assert row > 1 or path == ("machines",)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no JSON"),
        ("{", "no JSON"),
        ('{"format": 1, "format": 2}', "key 'format' is given twice"),
        ('{"version": NaN}', "NaN is no number"),
        ("[" * 100_000, "nested too deeply"),
        ("[]", "a mapping"),
        ("\x00", "no JSON"),
    ],
)
def test_what_is_no_such_json_is_refused(text: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    file.write_text(text, encoding="utf-8")
    assert words in " ".join(invoke("judge", file, code=2).stderr.split())


def test_a_plan_without_a_task_asks_for_one(tmp_path: Path) -> None:
    content = yard(tmp_path)
    del content["scenario"]
    file = filed(content, tmp_path)
    assert "--scenario" in invoke("judge", file, code=2).stderr
    given = ("judge", file, "--scenario", tmp_path / "yard.yaml", "--json")
    told = json.loads(invoke(*given, "--seeds", "0", code=0).stdout)
    assert told["clean"]
    assert told["planned_s"] == 32.0


@pytest.mark.parametrize("many", [{"t_s": ["x"] * 100_000}, {"t_s": [9, 1] * 100_000}])
def test_of_very_many_faults_the_first_are_told(tmp_path: Path, many: Any) -> None:
    """Each of millions would take minutes and gigabytes."""
    motion = {"id": "a", "q": [[0]], **many}
    robot = {"joints": ["a"], "motions": [motion]}
    head = {"format": FORMAT, "version": 1, "robots": {"west": robot}}
    (path := tmp_path / "plan.json").write_text(json.dumps(head))
    with pytest.raises(InvalidScenarioError) as caught:
        read_open_plan(path)
    assert 1 <= len(caught.value.problems) <= 100
    assert "robots.west.motions[0].t_s[" in caught.value.report()
