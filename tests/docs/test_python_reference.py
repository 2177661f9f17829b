"""The reference of the Python names is what their docstrings say, and every test, file and benchmark that pages name is there."""

import re
from pathlib import Path

import pytest

import twin
from tests.scripts import DOCS, script


def test_the_page_is_that_of_the_docstrings() -> None:
    page = script("python_reference").page()
    committed = (DOCS / "reference/python.md").read_text(encoding="utf-8")
    assert committed == page, "python docs/python_reference.py"


def test_every_name_is_on_it_and_every_table_in_the_guide() -> None:
    made = script("python_reference")
    assert {*made.FUNCTIONS, *made.RESULTS, *made.ERRORS} == set(twin.__all__)
    guide = (DOCS / "guides/python.md").read_text(encoding="utf-8")
    for name in made.RESULTS:
        for member, value in vars(getattr(twin, name)).items():
            if isinstance(value, property) and "Table" in str(
                value.fget.__annotations__["return"]
            ):
                assert f"`{member}`" in guide, f"{name}.{member}"


ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("page", ["promises", "own-cells", "papers"])
def test_promises_name_tests_that_exist(page: str) -> None:
    text = (ROOT / f"docs/reference/{page}.md").read_text()
    named = set(re.findall(r"`(tests/[^`]+)`", text))
    assert len(named) > 10
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []
