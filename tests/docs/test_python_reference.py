"""The reference of the Python names is what their docstrings say."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import twin

DOCS = Path(__file__).parents[2] / "docs"


def script() -> ModuleType:
    """Import docs/python_reference.py, which is a script and in no package."""
    path = DOCS / "python_reference.py"
    spec = importlib.util.spec_from_file_location("python_reference", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_is_that_of_the_docstrings() -> None:
    page = script().page()
    committed = (DOCS / "reference/python.md").read_text(encoding="utf-8")
    assert committed == page, "python docs/python_reference.py"


def test_every_name_is_on_it_and_every_table_in_the_guide() -> None:
    made = script()
    assert {*made.FUNCTIONS, *made.RESULTS, "TwinError"} == set(twin.__all__)
    guide = (DOCS / "guides/python.md").read_text(encoding="utf-8")
    for name in made.RESULTS:
        for member, value in vars(getattr(twin, name)).items():
            if isinstance(value, property) and "Table" in str(
                value.fget.__annotations__["return"]
            ):
                assert f"`{member}`" in guide, f"{name}.{member}"
