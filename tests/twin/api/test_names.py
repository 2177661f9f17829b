"""``import twin`` costs nothing, and its names stay functions whatever is imported after it."""

import ast
from pathlib import Path

import pytest

import twin
from tests.twin.program import python


def test_every_name_is_there() -> None:
    assert sorted(twin.__all__) == sorted(twin._MODULES)
    table = {
        (item.name, node.module)
        for block in ast.parse(Path(twin.__file__).read_text()).body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for item in node.names
    }
    assert table == set(twin._MODULES.items()), "as type checkers are told"
    for name in twin.__all__:
        assert callable(getattr(twin, name)), name
        assert getattr(twin, name).__doc__, name
    assert str(twin.__version__).count(".") >= 2
    assert set(twin.__all__) < set(dir(twin))


def test_what_is_not_there_is_refused_as_of_any_module() -> None:
    with pytest.raises(AttributeError, match="no attribute 'simulat'"):
        twin.simulat  # noqa: B018


def test_a_name_of_a_part_that_is_not_installed_says_which(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(twin._MODULES, "study", "twin.no_such_part")
    monkeypatch.delitem(vars(twin), "study", raising=False)
    with pytest.raises(AttributeError, match=r"twin\.no_such_part, which is not inst"):
        twin.study  # noqa: B018


def test_no_folder_has_the_name_of_a_function() -> None:
    """Importing it would put it where the function is."""
    folders = {path.name for path in Path(twin.__file__).parent.iterdir()}
    assert folders.isdisjoint(twin.__all__)


def test_the_import_loads_nothing_heavy() -> None:
    code = "import sys, twin; print(*sorted(m.partition('.')[0] for m in sys.modules))"
    heavy = {"numpy", "pydantic", "matplotlib", "pyarrow", "numba", "typer", "yaml"}
    assert heavy.isdisjoint(python(code).stdout.split())
