"""The structures of the benchmark of growth are what it says they are."""

from pathlib import Path

import pytest
import yaml

from benchmarks.scaling import exponent, tower_field
from tests.assembly_section import assembly_section
from twin.kinds.lego.section import LegoSection
from twin.reading.scenario_file import load_scenario


@pytest.mark.parametrize("bricks", [4, 25, 800])
def test_a_field_of_towers_is_a_scenario(tmp_path: Path, bricks: int) -> None:
    file = tmp_path / "towers.yaml"
    file.write_text(yaml.safe_dump(tower_field(bricks)))
    assembly = assembly_section(load_scenario(file), LegoSection)
    assert len(assembly.steps) == bricks


def test_the_exponent_is_that_of_a_power() -> None:
    sizes = [100, 200, 400]
    assert exponent(sizes, [1e-4 * n**1.7 for n in sizes]) == pytest.approx(1.7)
