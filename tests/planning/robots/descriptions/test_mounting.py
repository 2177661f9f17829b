"""Tools on flanges, against pinocchio, which reads both descriptions and poses their joints."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
import pytest

from planning.cell.robot_model import RobotModel, ToolGrip
from planning.errors import FittingError
from planning.robots.descriptions.fitting import Fitting, Tool
from planning.robots.descriptions.urdf_file import GivenLimits
from planning.robots.registry import robot_model
from planning.transforms import Transform, from_rpy, inverse
from tests.planning.robots.descriptions.vendors import GRIPPER, robotiq, ur5e

MOUNT = from_rpy((0.01, -0.02, 0.03), (0.1, 0.2, 0.3))


@pytest.fixture
def gripper(tmp_path: Path) -> Path:
    path = tmp_path / "gripper.urdf"
    path.write_text(GRIPPER)
    return path


def link_poses(path: Path, values: dict[str, float]) -> dict[str, Transform]:
    """Return where pinocchio puts the links of a description, joints at some values."""
    model: Any = pinocchio.buildModelFromUrdf(str(path))
    q = pinocchio.neutral(model)
    for name, value in values.items():
        q[model.joints[model.getJointId(name)].idx_q] = value
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, q)
    return {
        frame.name: data.oMf[k].homogeneous
        for k, frame in enumerate(model.frames)
        if frame.type == pinocchio.FrameType.BODY
    }


def in_flange(model: RobotModel, link: str) -> Transform:
    """Return where a link of the fitted description is, in the frame of its flange."""
    poses = link_poses(model.urdf, {})
    return inverse(poses[model.flange_link]) @ poses[link]


def test_a_gripper_of_a_vendor_sits_where_pinocchio_puts_it() -> None:
    """All six joints of the 2F-85 are where one value puts them, on the flange that was asked for."""
    tool = Tool(
        name="hand",
        description=robotiq(),
        held={"finger_joint": 0.3},
        mount=MOUNT,
        tcp=from_rpy((0, 0, 0.14), (0, 0, 0)),
        closing="x",
    )
    model = robot_model(str(ur5e()), None, Fitting(tool=tool))
    follow = {
        "finger_joint": 0.3,
        "left_inner_knuckle_joint": 0.3,
        "left_inner_finger_joint": -0.3,
        "right_outer_knuckle_joint": 0.3,
        "right_inner_knuckle_joint": 0.3,
        "right_inner_finger_joint": -0.3,
    }
    wanted = link_poses(robotiq(), follow)
    for link, pose in wanted.items():
        found = in_flange(model, f"hand.{link}")
        assert np.allclose(found, MOUNT @ pose, atol=1e-9), link
    assert (model.name, model.flange_link, model.dof) == ("ur5e+hand", "tool0", 6)
    assert {part.group for part in model.parts[-11:]} == {"tool"}
    tip = model.frame_in_flange("tool")
    assert np.allclose(tip[:3, 3], (MOUNT @ (0, 0, 0.14, 1))[:3])
    # Fingers close along x of the tcp: that is y of the tool frame, up to its sign.
    assert np.isclose(abs(tip[:3, 1] @ MOUNT[:3, 0]), 1.0)
    assert np.allclose(tip[:3, 2], MOUNT[:3, 2])


def test_mimic_joints_follow_and_a_link_named_tcp_is_the_tcp(gripper: Path) -> None:
    tool = Tool(name="g", description=gripper, held={"squeeze": 0.025}, mount=MOUNT)
    model = robot_model("iiwa14", None, Fitting(tool=tool))
    centres = {
        part.body.name: part.body.vertices.mean(axis=0)
        for part in model.parts
        if part.group == "tool"
    }
    turn = inverse(model.flange @ MOUNT)
    for name, y in (("g.left_0", 0.03), ("g.right_0", -0.03)):
        at = turn @ np.append(centres[name], 1.0)
        assert np.allclose(at[:3], (0.0, y, 0.12), atol=1e-9)
    assert np.allclose(model.frames["tool"], MOUNT @ from_rpy((0, 0, 0.14), (0, 0, 0)))


def test_a_tool_takes_the_place_of_the_one_that_the_robot_comes_with(
    gripper: Path,
) -> None:
    bare, own = robot_model("panda"), Tool(name="g", description=gripper)
    model = robot_model("panda", None, Fitting(tool=own))
    assert not any(
        "hand" in p.body.name or "finger" in p.body.name for p in model.parts
    )
    assert np.allclose(model.flange, bare.flange)
    assert np.allclose(model.home, bare.home)
    assert np.allclose(model.velocity, bare.velocity)


def test_the_same_fitting_is_the_same_model_and_another_is_not(gripper: Path) -> None:
    def fitted(value: float, opening: float) -> RobotModel:
        tool = Tool(
            name="g",
            description=gripper,
            held={"squeeze": value},
            grip=ToolGrip((0.0, opening), "g"),
        )
        return robot_model("iiwa14", None, Fitting(tool=tool))

    assert fitted(0.01, 0.08) is fitted(0.01, 0.08)
    assert fitted(0.01, 0.08) is not fitted(0.02, 0.08)
    assert fitted(0.01, 0.08).grip == ToolGrip((0.0, 0.08), "g")
    assert fitted(0.01, 0.07).grip == ToolGrip((0.0, 0.07), "g")


def test_limits_are_for_all_joints_or_one_by_one(gripper: Path) -> None:
    limits = GivenLimits(
        velocity=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0), effort=(50.0,), payload=14.0
    )
    model = robot_model("iiwa14", None, Fitting(limits=limits))
    assert list(model.velocity) == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
    assert model.drives is not None
    assert set(model.drives.effort) == {50.0}
    assert np.isinf(model.drives.jerk).all()
    assert model.drives.payload == 14.0
    assert model.name == "iiwa14-fitted"
    assert model.urdf.is_file()
    few = Fitting(limits=GivenLimits(velocity=(1.0, 2.0)))
    with pytest.raises(FittingError, match="2 values; the robot has 7 joints") as found:
        robot_model("iiwa14", None, few)
    assert found.value.key == "limits"


def test_limits_that_a_vendor_writes_with_a_prefix_are_read() -> None:
    model = robot_model(str(ur5e()))
    assert model.drives is not None
    assert set(model.drives.acceleration) == {2.5}
    assert list(model.drives.effort) == [150.0] * 3 + [28.0] * 3


def test_z_points_out_of_the_flange_that_is_chosen() -> None:
    """On ROS-Industrial robots that is tool0; x points out of flange."""
    chosen, other = (
        robot_model(str(ur5e()), None, Fitting(flange=link))
        for link in (None, "flange")
    )
    assert (chosen.flange_link, other.flange_link) == ("tool0", "flange")
    axis = chosen.chain.axis[-1]
    assert np.isclose(chosen.flange[:3, 2] @ axis, 1.0)
    assert np.isclose(other.flange[:3, 0] @ axis, 1.0)


@pytest.mark.parametrize(
    ("fitting", "key", "words"),
    [
        (Fitting(flange="hand"), "flange", "'hand' is no link that a joint moves"),
        (Fitting(held={"thumb": 0.0}), "joints", "has no joint 'thumb' to hold"),
        (
            Fitting(held={"lbr_iiwa_joint_2": 9.0}),
            "joints",
            "cannot be held at 9: its limits are",
        ),
    ],
)
def test_what_does_not_fit_is_said_with_its_key(
    fitting: Fitting, key: str, words: str
) -> None:
    with pytest.raises(FittingError, match=words) as found:
        robot_model("iiwa14", None, fitting)
    assert found.value.key == key
    assert str(found.value).count("(valid: ") <= 1


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('name="tcp"', 'name="point"', "no valid child link"),
        ('link="tcp"', 'link="right"', "'right' has two parent joints"),
        ('joint="squeeze"', 'joint="nobody"', "mimics a joint that is not there"),
        ('joint="squeeze"', 'joint="follow"', "'follow' mimics itself"),
        ('size="0.02 0.01 0.06"', 'size="0.02 nan 0.06"', "must be a finite number"),
        ('multiplier="-1"', 'multiplier="much"', "multiplier must be a finite number"),
        ('upper="0.04"', 'upper="-1"', "'squeeze' has an empty range"),
        ('radius="0.04"', "", "link 'palm': a <cylinder> has no radius"),
    ],
)
def test_tools_that_cannot_be_used_are_explained(
    gripper: Path, old: str, new: str, words: str
) -> None:
    text = gripper.read_text()
    assert old in text
    gripper.write_text(text.replace(old, new))
    with pytest.raises(FittingError, match=words):
        robot_model("iiwa14", None, Fitting(tool=Tool(name="g", description=gripper)))


def test_a_tool_without_a_tcp_asks_for_one(gripper: Path) -> None:
    gripper.write_text(gripper.read_text().replace('"tcp"', '"middle"'))
    with pytest.raises(FittingError, match="the tool 'g' needs a 'tcp'"):
        robot_model("iiwa14", None, Fitting(tool=Tool(name="g", description=gripper)))


def test_meshes_of_a_fitted_description_lie_beside_it() -> None:
    """So that a plan takes them along, wherever it goes."""
    tool = Tool(name="hand", description=robotiq(), tcp=np.eye(4))
    model = robot_model(str(ur5e()), None, Fitting(tool=tool))
    root = ElementTree.parse(model.urdf).getroot()
    names = [str(mesh.get("filename")) for mesh in root.iter("mesh")]
    assert len(names) > 20
    for name in names:
        assert (model.urdf.parent / name).is_file()
