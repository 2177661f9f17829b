"""Shapes without a volume, such as makers write for links without a body, are left out and told; others are refused."""

import struct
from pathlib import Path

import pytest

from planning.errors import RobotModelError
from planning.robots.descriptions.fitting import Fitting
from planning.robots.descriptions.urdf_file import GivenLimits
from planning.robots.registry import robot_model
from tests.twin.program import invoke
from twin.checks.overview import robot_overview

URDF = """<robot name="own">
  <link name="foot"><collision><geometry><cylinder radius="0.06" length="0.02"/></geometry></collision></link>
  <link name="rod"><collision><geometry><box size="0.03 0.03 0.4"/></geometry></collision>
    <collision><geometry>FORM</geometry></collision><visual><geometry>FORM</geometry></visual></link>
  <joint name="turn" type="revolute"><parent link="foot"/><child link="rod"/><origin xyz="0 0 0.25"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="5" velocity="2"/></joint>
</robot>"""

MJCF = """<mujoco model="own"><worldbody>
  <geom type="box" size="0.05 0.05 0.01"/>
  <body name="rod" pos="0 0 0.25"><joint name="turn" type="hinge" axis="0 1 0" range="-60 60"/>
    <geom type="box" size="0.02 0.02 0.2"/><geom FORM/></body>
</worldbody></mujoco>"""

TRIANGLE = (
    "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 2 3\nf 1 4 2\nf 1 3 4\nf 2 4 3\n"
)
FILES = {
    "points.obj": b"# no faces\no nothing\nv 0 0 0\nv 1 0 0\nvn 0 0 1\n",
    "binary.stl": b"none".ljust(80) + bytes(4),
    "text.stl": b"solid none\nendsolid none\n",
    "body.obj": TRIANGLE.encode(),
    "pointer.obj": b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n",
    "cut.stl": b"binary".ljust(80) + (9).to_bytes(4, "little") + bytes(50),
    "nothing.stl": b"",
    "solid.stl": b"solid of a binary file".ljust(80)
    + (4).to_bytes(4, "little")
    + b"".join(
        struct.pack("<12fH", 0, 0, 0, *map(float, corners), 0)
        for corners in (
            (0, 0, 0, 0, 0.1, 0, 0.1, 0, 0),
            (0, 0, 0, 0.1, 0, 0, 0, 0, 0.1),
            (0, 0, 0, 0, 0, 0.1, 0, 0.1, 0),
            (0.1, 0, 0, 0, 0.1, 0, 0, 0, 0.1),
        )
    ),
}

EMPTY = (
    '<box size="0 0 0"/>',
    '<box size="0.2 0.1 0"/>',
    '<sphere radius="0"/>',
    '<cylinder radius="0" length="0.3"/>',
    '<cylinder radius="0.1" length="0.0"/>',
    '<mesh filename="points.obj"/>',
    '<mesh filename="binary.stl"/>',
    '<mesh filename="text.stl"/>',
    '<mesh filename="body.obj" scale="0 0 0"/>',
)

REFUSED = (
    '<box size="-0.1 0 0"/>',
    '<box size="nan 0 0"/>',
    '<box size="0 0 1e300"/>',
    '<box size="0 0"/>',
    '<box size="1e-9 1 1"/>',
    '<sphere radius="-1"/>',
    '<sphere radius="inf"/>',
    '<cylinder radius="0" length="-0.1"/>',
    '<cylinder length="0"/>',
    '<mesh filename="gone.obj"/>',
    '<mesh filename="pointer.obj"/>',
    '<mesh filename="cut.stl"/>',
    '<mesh filename="nothing.stl"/>',
)


def described(folder: Path, form: str, text: str = URDF) -> Path:
    for name, content in FILES.items():
        (folder / name).write_bytes(content)
    path = folder / f"arm.{'urdf' if text is URDF else 'xml'}"
    path.write_text(text.replace("FORM", form))
    return path


@pytest.mark.parametrize("form", EMPTY)
def test_what_has_no_volume_is_left_out_and_told(form: str, tmp_path: Path) -> None:
    model = robot_model(str(described(tmp_path, form)))
    assert [part.body.name for part in model.parts] == ["foot_0", "rod_0"]
    (words,) = robot_overview(model).left_out
    assert "link 'rod'" in words
    assert any(words in line for line in robot_overview(model).words)


@pytest.mark.parametrize("form", REFUSED)
def test_what_no_body_measures_is_refused(form: str, tmp_path: Path) -> None:
    with pytest.raises(RobotModelError):
        robot_model(str(described(tmp_path, form)))


def test_a_body_stays(tmp_path: Path) -> None:
    model = robot_model(str(described(tmp_path, '<mesh filename="body.obj"/>')))
    assert len(model.parts) == 3
    assert robot_overview(model).left_out == ()


@pytest.mark.parametrize(
    ("geom", "there"),
    [
        ('type="sphere" size="0"', False),
        ('type="box" size="0 0 0"', False),
        ('type="cylinder" size="0.1 0"', False),
        ('type="cylinder" size="0.1" fromto="0 0 0 0 0 0"', False),
        ('type="capsule" size="0.05 0"', True),
        ('type="sphere" size="0.1"', True),
    ],
)
def test_so_it_is_in_mjcf(geom: str, there: bool, tmp_path: Path) -> None:
    speeds = Fitting(limits=GivenLimits(velocity=(1.0,)))
    model = robot_model(str(described(tmp_path, geom, MJCF)), None, speeds)
    assert bool(robot_overview(model).left_out) != there


def test_the_program_refuses_what_no_body_measures(tmp_path: Path) -> None:
    assert invoke("robots", described(tmp_path, REFUSED[0]), code=2).output


def test_a_binary_mesh_whose_header_says_solid_is_a_body(tmp_path: Path) -> None:
    path = described(tmp_path, '<mesh filename="solid.stl"/>')
    model = robot_model(str(path))
    assert sum(part.link == "rod" for part in model.parts) == 2
    assert robot_overview(model).left_out == ()
