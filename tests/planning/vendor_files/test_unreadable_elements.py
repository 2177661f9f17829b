"""An element that the parser cannot read takes no collision shape with it: it is left out with a note, or refused."""

from pathlib import Path

import pytest

from planning.errors import RobotModelError
from planning.robots.registry import robot_model
from tests.planning.vendor_files.folding_arm import URDF

LINK = '<link name="link3">'
INERTIAL = '<inertial><mass value="{}"/><inertia ixx="{}" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'


def described(folder: Path, more: str) -> Path:
    path = folder / "arm.urdf"
    assert URDF.count(LINK) == 1
    path.write_text(URDF.replace(LINK, LINK + more))
    return path


@pytest.mark.parametrize(
    "more",
    ["<collision/>", "<collision><geometry/></collision>", "<visual/>"],
)
def test_a_shape_without_geometry_is_left_out(more: str, tmp_path: Path) -> None:
    model = robot_model(str(described(tmp_path, more)))
    assert [part.link for part in model.parts] == ["foot", "link1", "link2", "link3"]


@pytest.mark.parametrize(
    "more",
    [
        INERTIAL.format("x", 1),
        INERTIAL.format(1, "x"),
        '<visual><geometry><box size="x"/></geometry></visual>',
        '<visual><origin xyz="1 2"/><geometry><box size="1 1 1"/></geometry></visual>',
    ],
)
def test_an_element_that_hides_shapes_is_refused(more: str, tmp_path: Path) -> None:
    path = described(tmp_path, more)
    with pytest.raises(RobotModelError) as error:
        robot_model(str(path))
    assert f"{path}: link 'link3'" in error.value.message


DAMAGED = {
    "<link/>": "a <link> has no name",
    "<a>" * 3000 + "</a>" * 3000: "nested more than 100 deep",
    '<joint name="j" type="ball"><parent link="hand"/><child link="b"/></joint>': "valid",
    '<joint name="j" type="fixed"><parent link="gone"/><child link="hand"/></joint>': "no valid parent link",
    '<joint name="j" type="fixed"><parent link="hand"/><child link="foot"/></joint>': "needs one root link, has none",
    '<link name="b"/>': "needs one root link",
    '<link name="hand"/>': "two links called 'hand'",
    '<assembly_twin flange="hand" home="1 2"/>': "3 joints that move, and 2 values of HOME",
}


@pytest.mark.parametrize("text", DAMAGED)
def test_a_damaged_description_is_refused_with_its_place(
    text: str, tmp_path: Path
) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(URDF.replace("</robot>", text + "</robot>"))
    with pytest.raises(RobotModelError) as error:
        robot_model(str(path))
    assert str(path) in error.value.message
    assert DAMAGED[text] in str(error.value)
