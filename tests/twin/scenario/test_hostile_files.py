"""Scenario files that once ended in a traceback, a hang or out of memory are refused at their place."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from twin.cli import app

SCENARIOS = Path(__file__).parents[3] / "scenarios"
ARMS, WALL = "multi_arm/multi_goal.yaml", "construction/wall.yaml"
WELL, TOWER = "construction/well.yaml", "construction/tower.yaml"

SCALED = """\
<robot name="r">
  <link name="a"><collision><geometry>
    <mesh filename="c.stl" scale="-1 0 1e300"/></geometry></collision></link>
  <link name="b"/>
  <joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
</robot>
"""

TRIANGLE = """\
solid a
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0
endloop
endfacet
endsolid a
"""

CASES = [
    (ARMS, "seed: 0", "seed: 0x" + "f" * 4000, "12:7: seed: a whole number expected"),
    (ARMS, "model: panda", "model: " + "a" * 300, "16:27: unknown robot model 'aaa"),
    (ARMS, "model: panda", 'model: "pan\\0da"', "16:27: no robot 'pan"),
    (ARMS, "model: panda", "model: /dev/zero", "16:27: unknown robot model"),
    (ARMS, "model: panda", "model: scaled.urdf", "scale of a <mesh> must be 1e-09 to"),
    (ARMS, "name: multi_goal", "name: multi\a", "not a text file"),
    (ARMS, "planning:", "planning:\n  speed_rad_s: 1.0e-6", "must be at least 0.01"),
    (ARMS, "planning:", "planning:\n  speed_rad_s: 1.0e+9", "must be at most 100"),
    (WALL, "[0.5, 0.2, 0.2]", "[5.0e-324, 0.2, 0.2]", "size_m[0]: must be at least"),
    (WELL, "radius_m: 0.86", "radius_m: 5.0e-324", "radius_m: must be at least 0.001"),
    (TOWER, "[0.6, 0.2, 0.12]", "[0.7, 1.0e-308, 1]", "size_m[1]: must be at least"),
    (
        "construction/pavilion.yaml",
        "joint_m: 0.012",
        "joint_m: 0.4",
        "the joint leaves nothing of it",
    ),
]


def validate(path: Path) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["validate", str(path)])
    return result.exit_code, result.output


@pytest.mark.parametrize(("name", "good", "bad", "message"), CASES)
def test_hostile_values_are_refused_at_their_place(
    tmp_path: Path, name: str, good: str, bad: str, message: str
) -> None:
    text = (SCENARIOS / name).read_text(encoding="utf-8")
    assert good in text
    path = tmp_path / "hostile.yaml"
    path.write_text(text.replace(good, bad, 1), encoding="utf-8")
    (tmp_path / "scaled.urdf").write_text(SCALED)
    (tmp_path / "c.stl").write_text(TRIANGLE)
    code, said = validate(path)
    assert code == 2
    assert said.startswith(f"{path}:")
    assert message in said
    assert "Traceback" not in said


@pytest.mark.parametrize("text", ["[" * 3000 + "]" * 3000, '{"a":' * 3000])
def test_deep_files_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "deep.yaml"
    path.write_text(text)
    code, said = validate(path)
    assert code == 2
    assert "1:1: the file is nested too deeply" in said
