"""What is left of the program without one of its wings."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.scripts import script

HOUSE = script("house")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("wings")


@pytest.mark.nightly
@pytest.mark.parametrize("wing", HOUSE.wings())
def test_the_rest_runs_without_a_wing(wing: str, folder: Path) -> None:
    assert HOUSE.fault_without(wing, folder) == ""


def test_what_needs_a_wing_goes_with_it() -> None:
    declared = {
        "grips": HOUSE.Wing("", (), ()),
        "audit": HOUSE.Wing("", (), ("grips",), ("grips",)),
        "judge": HOUSE.Wing("", (), ("audit",), ("audit",)),
        "exports": HOUSE.Wing("", (), ("judge",)),
    }
    assert HOUSE.gone_without("grips", declared) == ["grips", "audit", "judge"]
    assert HOUSE.gone_without("exports", declared) == ["exports"]
