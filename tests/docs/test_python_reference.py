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
    assert {*made.FUNCTIONS, *made.RESULTS, "TwinError"} == set(twin.__all__)
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


def test_the_page_of_the_papers_names_what_is_there() -> None:
    """Each row says where something is, and what shows it, but for hardware and learning."""
    text = (ROOT / "docs/reference/papers.md").read_text()
    rows = [
        line.split("|")[1:-1] for line in text.splitlines() if line.startswith("| ")
    ]
    rows = [[cell.strip() for cell in row] for row in rows if row[0].strip("- ")]
    assert len(rows) > 40
    for what, where, differs, shown in rows:
        absent = re.search(r"(hardware|learning): no|not yet", differs)
        assert (where and shown) or absent, what
        for name in re.findall(r"`([a-z_]+/[^` ]*)`", where + shown):
            assert (ROOT / name.rstrip("/")).exists(), (what, name)
        for name in re.findall(r"`python -m (benchmarks\.\w+)", where + shown):
            module = ROOT / name.replace(".", "/")
            assert module.is_dir() or module.with_suffix(".py").exists(), (what, name)
