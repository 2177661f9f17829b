"""Scenario files that once ended in a traceback, a hang or out of memory are refused at their place."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.planted import rows
from tests.shipped_runs import SCENARIOS
from twin.cli import app

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

CASES = rows(r"""
file                       | old              | new                         | says
multi_arm/multi_goal       | seed: 0          | BIG                         | 12:7: seed: a whole number expected
multi_arm/multi_goal       | model: panda     | LONG                        | 16:27: unknown robot model 'aaa
multi_arm/multi_goal       | model: panda     | "model: \"pan\\0da\""       | 16:27: no robot 'pan
multi_arm/multi_goal       | model: panda     | model: /dev/zero            | 16:27: unknown robot model
multi_arm/multi_goal       | model: panda     | model: scaled.urdf          | scale of a <mesh> must be 1e-09 to
multi_arm/multi_goal       | name: multi_goal | "name: multi\u0007"         | not a text file
multi_arm/multi_goal       | planning:        | "planning:\n  speed_rad_s: 1.0e-6" | must be at least 0.01
multi_arm/multi_goal       | planning:        | "planning:\n  speed_rad_s: 1.0e+9" | must be at most 100
construction/wall          | [0.5, 0.2, 0.2]  | [5.0e-324, 0.2, 0.2]        | size_m[0]: must be at least
construction/well          | radius_m: 0.86   | radius_m: 5.0e-324          | radius_m: must be at least 0.001
construction/tower         | [0.6, 0.2, 0.12] | [0.7, 1.0e-308, 1]          | size_m[1]: must be at least
construction/pavilion      | joint_m: 0.012   | joint_m: 0.4                | the joint leaves nothing of it
assembly/shapes            | shapes_housing.stl, | other.stl,               | LINE other.stl is not there
assembly/shapes            | shapes_housing.stl, | housing.step,            | LINE unknown kind
assembly/shapes            | , scale: 0.001   | ""                          | LINE measures 80 x 36 x 20 m: LINE write scale: 0.001
assembly/shapes            | , scale: 0.001   | , scale: 0.000001           | LINE a tenth of a millimetre: leave scale
assembly/shapes            | {cylinder: {radius_m: 0.12, length_m: 0.02}} | {} | LINE give one of box
assembly/shapes            | length_m: 0.06}  | length_m: 0.06, box: [1, 1, 1]} | LINE box
assembly/shapes            | "      shape: {mesh" | "      size_m: [1, 1, 1]\n      shape: {mesh" | not both
""")


def validate(path: Path) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["validate", str(path)])
    return result.exit_code, result.output


@pytest.mark.parametrize(
    ("name", "good", "bad", "message"), CASES, ids=lambda cell: cell[:30]
)
def test_hostile_values_are_refused_at_their_place(
    tmp_path: Path, name: str, good: str, bad: str, message: str
) -> None:
    source = SCENARIOS / f"{name}.yaml"
    text = source.read_text(encoding="utf-8")
    assert good in text
    line = next(k for k, row in enumerate(text.splitlines(), 1) if good in row)
    bad = {"BIG": "seed: 0x" + "f" * 4000, "LONG": "model: " + "a" * 300}.get(bad, bad)
    path = tmp_path / "hostile.yaml"
    path.write_text(text.replace(good, bad, 1), encoding="utf-8")
    (tmp_path / "scaled.urdf").write_text(SCALED)
    (tmp_path / "c.stl").write_text(TRIANGLE)
    for mesh in source.parent.glob("*.stl"):
        shutil.copy(mesh, tmp_path)
    code, said = validate(path)
    assert code == 2
    assert said.startswith(f"{path}:")
    at, *words = message.split("LINE ")
    assert at in said
    assert all(part in said for part in words)
    assert not words or f"{path}:{line}:" in said
    assert "Traceback" not in said


@pytest.mark.parametrize("text", ["[" * 3000 + "]" * 3000, '{"a":' * 3000])
def test_deep_files_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "deep.yaml"
    path.write_text(text)
    code, said = validate(path)
    assert code == 2
    assert "1:1: the file is nested too deeply" in said
