"""What is written as a scenario reads back as it was."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from twin.scenario.document.yaml_text import read_yaml, scenario_text

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
    # People wrote these files by hand; ours may not be much longer.
    assert len(text.splitlines()) < 2 * len(path.read_text().splitlines())
