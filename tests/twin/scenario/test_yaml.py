"""YAML is read as people mean it, and every value knows its place."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from twin.scenario.document.yaml_text import (
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
