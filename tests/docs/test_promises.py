"""Every test that the pages of promises and of own cells name is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("page", ["promises", "own-cells"])
def test_promises_name_tests_that_exist(page: str) -> None:
    text = (ROOT / f"docs/reference/{page}.md").read_text()
    named = set(re.findall(r"`(tests/[^`]+)`", text))
    assert len(named) > 10
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []
