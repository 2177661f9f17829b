"""Changes of single values in YAML texts: the content is as it should be, and all other lines stay."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.errors import RequestError
from twin.document.yaml_text import read_yaml
from twin.scenario.shipped import shipped_scenarios
from twin.view.edited_text import with_entry, with_value

TEXT = """\
# A cell.
cell:
  robots:
    - {name: left, model: ur5e, base: {xyz_m: [0, 0, 0.5]}}  # stays
    - name: right   # of two
      model: panda
      base:
        xyz_m: [1, 0, 0]

    # between
  fixtures:
    - {name: table, size_m: [1, 1, 0.1]}
assembly:
  sources:
    belt: {kind: feeder}
  parts: []
"""


def content(text: str) -> Any:
    found = read_yaml(Path("cell.yaml"), text)
    assert not found.problems
    return found.data


def test_one_line_changes() -> None:
    out = with_value(TEXT, ("cell", "robots", 0, "base", "xyz_m"), [0.25, -1.0, 1e-7])
    assert out == TEXT.replace("[0, 0, 0.5]", "[0.25, -1, 0]")
    out = with_value(TEXT, ("cell", "robots", 1, "base", "rpy_deg"), [0, 0, 90.5])
    assert out == TEXT.replace(
        "xyz_m: [1, 0, 0]\n", "xyz_m: [1, 0, 0]\n        rpy_deg: [0, 0, 90.5]\n"
    )
    out = with_value(TEXT, ("cell", "robots", 0, "base", "rpy_deg"), [0, 0, 90])
    assert out == TEXT.replace("0.5]}}", "0.5], rpy_deg: [0, 0, 90]}}")


def test_entries_are_added() -> None:
    box = {"name": "box 1", "size_m": [0.1, 0.2, 0.3]}
    words = '{name: "box 1", size_m: [0.1, 0.2, 0.3]}'
    out = with_entry(TEXT, ("cell", "fixtures"), box)
    table = "    - {name: table, size_m: [1, 1, 0.1]}\n"
    assert out == TEXT.replace(table, f"{table}    - {words}\n")
    assert with_entry(TEXT, ("assembly", "parts"), box) == TEXT.replace(
        "parts: []", f"parts: [{words}]"
    )
    out = with_entry(TEXT, ("assembly", "sources"), {"name": "tray", "kind": "tray"})
    assert content(out)["assembly"]["sources"]["tray"] == {"kind": "tray"}
    assert content(with_entry(TEXT, ("cell", "tools"), box))["cell"]["tools"] == [box]


@pytest.mark.parametrize(
    "path",
    [("cell", "robots", 7, "base"), ("cel", "robots"), ("cell", "robots", 9)],
    ids=str,
)
def test_what_has_no_place_is_refused(path: tuple[Any, ...]) -> None:
    with pytest.raises(RequestError, match="nothing at"):
        with_value(TEXT, path, 1)


def test_files_with_aliases_are_left_alone() -> None:
    with pytest.raises(RequestError, match="aliases"):
        with_value("a: &x {b: 1}\nc: *x\n", ("c", "b"), 2)


def test_files_that_are_no_yaml_are_left_alone() -> None:
    with pytest.raises(RequestError, match="not valid"):
        with_value("cell: [", ("cell",), 2)


def paths_of(data: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    entries = data.items() if isinstance(data, dict) else enumerate(data)
    found = []
    for key, value in entries:
        found.append((*at, key))
        if isinstance(value, dict | list):
            found += paths_of(value, (*at, key))
    return found


VALUES = st.one_of(
    st.floats(-100, 100).map(lambda x: round(x, 6)),
    st.lists(st.floats(-9, 9).map(lambda x: round(x, 5)), min_size=3, max_size=3),
    st.sampled_from(["on", "1e3", "a: b", "ok", "# no", "", "null", "é\n"]),
    st.integers(-5, 5),
)
SHORT = sorted(
    path
    for path in shipped_scenarios().values()
    if path.stat().st_size < 6000 and ": &" not in path.read_text()  # no aliases
)


@settings(max_examples=60)
@given(st.sampled_from(SHORT), st.data(), VALUES)
def test_any_value_of_any_scenario(file: Path, data: st.DataObject, value: Any) -> None:
    text = file.read_text()
    expected = content(text)
    path = data.draw(st.sampled_from(paths_of(expected)))
    changed = with_value(text, path, value)
    inner = expected
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    assert content(changed) == expected
    # Lines before and after the value stay as they are.
    old, new = text.splitlines(), changed.splitlines()
    same = next(
        (k for k, (a, b) in enumerate(zip(old, new, strict=False)) if a != b), len(new)
    )
    assert old[:same] == new[:same]
    for line in (line for line in old if line.lstrip().startswith("#")):
        assert line in new or path_holds(file, path, line)


def path_holds(file: Path, path: tuple[Any, ...], line: str) -> bool:
    """Return whether a comment is within the value that was replaced."""
    found = read_yaml(file, file.read_text())
    first = found.values[path].line
    return line in found.lines[first - 1 :]
