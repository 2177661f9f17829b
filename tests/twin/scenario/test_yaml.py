"""YAML is read as people mean it, and every value knows its place."""

import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tests.planted import rows
from tests.shipped_runs import SCENARIOS
from tests.twin.program import invoke
from twin.document.yaml_text import (
    Mark,
    YamlDocument,
    read_yaml,
    scenario_text,
)


def read(text: str) -> YamlDocument:
    return read_yaml(Path("file.yaml"), text)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e3", 1000.0),
        ("-1.5E-2", -0.015),
        (".5", 0.5),
        ("1.", 1.0),
        ("0x1F", 31),
        ("0o17", 15),
        ("010", 10),
        ("+7", 7),
        ("on", "on"),
        ("off", "off"),
        ("yes", "yes"),
        ("no", "no"),
        ("1:30", "1:30"),
        ("1_000", "1_000"),
        ("2026-11-21", "2026-11-21"),
        ("true", True),
        ("False", False),
        ("~", None),
        ("null", None),
        ("2x4", "2x4"),
        ("'1e3'", "1e3"),
        ('"true"', "true"),
    ],
)
def test_scalars_follow_yaml_1_2(text: str, value: object) -> None:
    document = read(f"a: {text}\n")
    assert document.problems == ()
    assert document.data == {"a": value}
    assert type(document.data["a"]) is type(value)


def test_every_value_has_its_place() -> None:
    document = read("a:\n  - b: 1\n    c: [2, 3]\n")
    assert document.values[("a", 0, "c", 1)] == Mark(3, 12)
    assert document.keys[("a", 0, "c")] == Mark(3, 5)
    assert document.mark_of(("a", 0, "no such key", "c")) == Mark(3, 8)


def test_a_key_given_twice_is_a_problem_and_the_first_stays() -> None:
    document = read("a: 1\nb: 2\na: 3\n")
    assert [(p.mark, p.message) for p in document.problems] == [
        (Mark(3, 1), "key 'a' is already given on line 1")
    ]
    assert document.data == {"a": 1, "b": 2}


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("", (1, 1), "the file is empty"),
        ("# only a comment\n", (1, 1), "the file is empty"),
        ("a: [1, 2\nb: 3\n", (2, 2), "not valid YAML"),
        ("a:\n\t- 1\n", (2, 1), "indent with spaces"),
        ("a: 1\n---\nb: 2\n", (3, 1), "a second document"),
        ("a: !!python/object:os.system {}\n", (1, 4), "is not supported"),
        ("a: !!python/name:os.system x\n", (1, 4), "is not supported"),
        ("a: !mine 3\n", (1, 4), "is not supported"),
        ("? [1, 2]\n: 3\n", (1, 3), "a key must be plain text"),
        ("a: &x {b: 1}\nc: {<<: *x}\n", (2, 5), "merge keys"),
        ("a: &x [*x]\n", (1, 4), "an alias refers to something that contains it"),
        ("a: *nowhere\n", (1, 4), "undefined alias"),
        ("a: \x07\n", (1, 4), "not a text file"),
    ],
)
def test_problems_have_a_place(text: str, place: tuple[int, int], words: str) -> None:
    problems = read(text).problems
    assert any(words in p.message for p in problems), problems
    assert problems[0].mark == Mark(*place)


def test_an_alias_bomb_is_stopped() -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 9)]
    assert any("more than" in p.message for p in read("\n".join(lines)).problems)


_PLAIN = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(10**9), 10**9)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text("abcxyz _-.", max_size=8),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text("abcdef", min_size=1), inner, max_size=4)
    ),
    max_leaves=12,
)


@given(st.dictionaries(st.text("abcdef", min_size=1), _PLAIN, min_size=1, max_size=4))
def test_what_pyyaml_writes_is_read_back(data: dict[str, object]) -> None:
    assert read(yaml.safe_dump(data)).data == data


SHIPPED = sorted((Path(__file__).parents[3] / "scenarios").rglob("*.yaml"))

_WORDS = st.text("abcxyz0123456789 _-.:#e+", max_size=12)
_SCALARS = (
    st.none()
    | st.booleans()
    | st.integers(-(10**6), 10**6)
    | st.floats(-1e6, 1e6, allow_nan=False)
    | _WORDS
)
_VALUES = st.recursive(
    _SCALARS,
    lambda inner: (
        st.lists(inner, max_size=5)
        | st.dictionaries(st.text("abcdef_", min_size=1, max_size=6), inner, max_size=5)
    ),
    max_leaves=25,
)


@given(st.dictionaries(st.text("abcdef_", min_size=1, max_size=6), _VALUES, min_size=1))
def test_content_survives(content: dict[str, Any]) -> None:
    document = read_yaml(Path("file.yaml"), scenario_text(content, "A note."))
    assert document.problems == ()
    assert document.data == content


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.stem)
def test_shipped_scenarios_survive_with_short_lines(path: Path) -> None:
    content = read_yaml(path, path.read_text()).data
    text = scenario_text(content, "one\ntwo")
    assert text.startswith("# one\n# two\nversion: 1\n")
    assert read_yaml(path, text).data == content
    assert max(len(line) for line in text.splitlines()) <= 130
    assert yaml.safe_load(text)["name"] == content["name"]
    # People wrote these files by hand, some in long lines; ours may not be much longer.
    by_hand = sum(1 + len(line) // 60 for line in path.read_text().splitlines())
    assert len(text.splitlines()) < 2 * by_hand


SCALED = """\
<robot name="r">
  <link name="a"><collision><geometry>
    <mesh filename="c.stl" scale="-1 0 1e300"/></geometry></collision></link>
  <link name="b"/>
  <joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
</robot>
"""

TRIANGLE = """\
solid a
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0
endloop
endfacet
endsolid a
"""

CASES = rows(r"""
file                       | old              | new                         | says
multi_arm/multi_goal       | seed: 0          | BIG                         | 12:7: seed: a whole number expected
multi_arm/multi_goal       | model: panda     | LONG                        | 16:27: unknown robot model 'aaa
multi_arm/multi_goal       | model: panda     | "model: \"pan\\0da\""       | 16:27: no robot 'pan
multi_arm/multi_goal       | model: panda     | model: /dev/zero            | 16:27: unknown robot model
multi_arm/multi_goal       | model: panda     | model: scaled.urdf          | scale of a <mesh> must be 1e-09 to
multi_arm/multi_goal       | name: multi_goal | "name: multi\u0007"         | not a text file
multi_arm/multi_goal       | planning:        | "planning:\n  speed_rad_s: 1.0e-6" | must be at least 0.01
multi_arm/multi_goal       | planning:        | "planning:\n  speed_rad_s: 1.0e+9" | must be at most 100
construction/wall          | [0.5, 0.2, 0.2]  | [5.0e-324, 0.2, 0.2]        | size_m[0]: must be at least
construction/well          | radius_m: 0.86   | radius_m: 5.0e-324          | radius_m: must be at least 0.001
construction/tower         | [0.6, 0.2, 0.12] | [0.7, 1.0e-308, 1]          | size_m[1]: must be at least
construction/pavilion      | joint_m: 0.012   | joint_m: 0.4                | the joint leaves nothing of it
assembly/shapes            | shapes_housing.stl, | other.stl,               | LINE other.stl is not there
assembly/shapes            | shapes_housing.stl, | housing.step,            | LINE unknown kind
assembly/shapes            | , scale: 0.001   | ""                          | LINE measures 80 x 36 x 20 m: LINE write scale: 0.001
assembly/shapes            | , scale: 0.001   | , scale: 0.000001           | LINE a tenth of a millimetre: leave scale
assembly/shapes            | {cylinder: {radius_m: 0.12, length_m: 0.02}} | {} | LINE give one of box
assembly/shapes            | length_m: 0.06}  | length_m: 0.06, box: [1, 1, 1]} | LINE box
assembly/shapes            | "      shape: {mesh" | "      size_m: [1, 1, 1]\n      shape: {mesh" | not both
""")


@pytest.mark.parametrize(
    ("name", "good", "bad", "message"), CASES, ids=lambda cell: cell[:30]
)
def test_hostile_values_are_refused_at_their_place(
    tmp_path: Path, name: str, good: str, bad: str, message: str
) -> None:
    source = SCENARIOS / f"{name}.yaml"
    text = source.read_text(encoding="utf-8")
    assert good in text
    line = next(k for k, row in enumerate(text.splitlines(), 1) if good in row)
    bad = {"BIG": "seed: 0x" + "f" * 4000, "LONG": "model: " + "a" * 300}.get(bad, bad)
    path = tmp_path / "hostile.yaml"
    path.write_text(text.replace(good, bad, 1), encoding="utf-8")
    (tmp_path / "scaled.urdf").write_text(SCALED)
    (tmp_path / "c.stl").write_text(TRIANGLE)
    for mesh in source.parent.glob("*.stl"):
        shutil.copy(mesh, tmp_path)
    said = invoke("validate", path, code=2).output
    assert said.startswith(f"{path}:")
    at, *words = message.split("LINE ")
    assert at in said
    assert all(part in said for part in words)
    assert not words or f"{path}:{line}:" in said
    assert "Traceback" not in said


@pytest.mark.parametrize("text", ["[" * 3000 + "]" * 3000, '{"a":' * 3000])
def test_deep_files_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "deep.yaml"
    path.write_text(text)
    said = invoke("validate", path, code=2).output
    assert "1:1: the file is nested too deeply" in said
