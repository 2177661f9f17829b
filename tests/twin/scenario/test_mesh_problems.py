"""Meshes that cannot be used are named where the scenario names them."""

from pathlib import Path

import pytest

from planning.errors import ScenarioError
from twin.scenario.manifest import load_scenario
from twin.scenario.shipped import begin_scenario


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("shapes_housing.stl,", "other.stl,", r"other\.stl is not there"),
        (", scale: 0.001", "", r"measures 80 x 36 x 20 m: .* write scale: 0\.001"),
        ("shapes_housing.stl,", "housing.step,", r"unknown kind"),
        (
            ", scale: 0.001",
            ", scale: 0.000001",
            r"a tenth of a millimetre: leave scale",
        ),
    ],
)
def test_a_mesh_that_cannot_be_used_has_a_line(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    file = begin_scenario(tmp_path / "own.yaml", "shapes")
    text = file.read_text()
    line = next(k for k, row in enumerate(text.splitlines(), 1) if old in row)
    file.write_text(text.replace(old, new))
    with pytest.raises(ScenarioError, match=words) as error:
        load_scenario(file)
    assert f"own.yaml:{line}:" in str(error.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("{cylinder: {radius_m: 0.12, length_m: 0.02}}", "{}", "give one of box"),
        ("length_m: 0.06}", "length_m: 0.06, box: [1, 1, 1]}", "box"),
        (
            "      shape: {mesh",
            "      size_m: [1, 1, 1]\n      shape: {mesh",
            "not both",
        ),
    ],
)
def test_a_shape_that_is_none_or_two_has_a_line(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    file = begin_scenario(tmp_path / "own.yaml", "shapes")
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    with pytest.raises(ScenarioError, match=words) as error:
        load_scenario(file)
    assert "own.yaml:" in str(error.value)
