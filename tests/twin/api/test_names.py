"""``import twin`` costs nothing, and its names stay functions whatever is imported after it."""

import sys
from importlib import import_module
from types import ModuleType

import pytest

import twin
from tests.twin.program import python


def test_every_name_is_there() -> None:
    assert sorted(twin.__all__) == sorted(twin._MODULES)
    for name in twin.__all__:
        assert callable(getattr(twin, name)), name
        assert getattr(twin, name).__doc__, name
    assert twin.__version__.count(".") >= 2
    assert set(twin.__all__) < set(dir(twin))


def test_what_is_not_there_is_refused_as_of_any_module() -> None:
    with pytest.raises(AttributeError, match="no attribute 'simulat'"):
        twin.simulat  # noqa: B018


def test_rooms_do_not_take_the_place_of_functions() -> None:
    for room in ("audit.audit", "check.check", "run.events", "study.study"):
        import_module(f"twin.{room}")
    for name in ("audit", "check", "run", "study"):
        assert isinstance(sys.modules[f"twin.{name}"], ModuleType)
        assert not isinstance(getattr(twin, name), ModuleType)


def test_the_import_loads_nothing_heavy() -> None:
    code = "import sys, twin; print(*sorted(m.partition('.')[0] for m in sys.modules))"
    heavy = {"numpy", "pydantic", "matplotlib", "pyarrow", "numba", "typer", "yaml"}
    assert heavy.isdisjoint(python(code).stdout.split())
