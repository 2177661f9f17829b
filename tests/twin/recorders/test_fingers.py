"""Fingers of tools slide in what is drawn until they touch the part, as another library reads it."""

from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.robot_model import RobotModel
from planning.cell.shape import Box, Element, box_shape
from planning.cell.workcell import CellObject, PlacedRobot
from planning.kinematics.kinematics import frame_pose
from planning.robots.descriptions.fitting import Fitting, Tool
from planning.robots.registry import robot_model
from planning.transforms import Transform, identity, inverse, translation
from tests.twin.audits.test_grips import cup, hand
from twin.drawing.looks import painted_description
from twin.rerun.fingers import closing_distance, split_fingers

Shown = dict[str, tuple[Transform, coal.CollisionGeometry]]


def shown(xml: str, q: np.ndarray, slides: float) -> Shown:
    """Return what a description shows, by name, with its fingers moved so far [m]."""
    model = pin.buildModelFromXML(xml)
    drawn = pin.buildGeomFromUrdfString(model, xml, pin.GeometryType.VISUAL)
    data, placed = model.createData(), pin.GeometryData(drawn)
    values = pin.neutral(model)
    arm = iter(q)
    for joint, name in zip(model.joints[1:], list(model.names)[1:], strict=True):
        values[joint.idx_q] = slides if ".finger_" in name else next(arm)
    pin.updateGeometryPlacements(model, data, drawn, placed, values)
    found = zip(drawn.geometryObjects, placed.oMg, strict=True)
    return {item.name: (at.homogeneous, item.geometry) for item, at in found}


def descriptions(model: RobotModel) -> tuple[PlacedRobot, str, str]:
    """Return a robot with its description as it is, and with fingers that slide."""
    robot = PlacedRobot("arm", model, np.eye(4), model.home)
    root = painted_description(robot, (200, 50, 50)).getroot()
    before = ElementTree.tostring(root, encoding="unicode")
    split_fingers(robot, root)
    return robot, before, ElementTree.tostring(root, encoding="unicode")


def box_and_hand() -> RobotModel:
    """Return an arm with a tool of one body that is all hand."""
    shapes = (Element(Box((0.05, 0.1, 0.1)), translation(0, 0, 0.05)),)
    tool = Tool(name="block", shapes=shapes, tcp=translation(0, 0, 0.1))
    return robot_model("ur5e", None, Fitting(tool=tool))


@settings(max_examples=10, deadline=None)
@given(st.sampled_from([0.0, 0.6]), st.floats(0.01, 0.05))
def test_fingers_touch_the_part_that_they_close_on(turn: float, wide: float) -> None:
    model = hand(turn)
    robot, before, after = descriptions(model)
    was, opened = shown(before, model.home, 0.0), shown(after, model.home, 0.0)
    assert len(was) == len(opened)
    for at, _ in was.values():
        assert any(np.allclose(at, now, atol=1e-6) for now, _ in opened.values())
    part = CellObject("part", "part", box_shape("part", (0.03, wide, 0.02)), identity())
    grip = model.frame_in_flange("tool")
    way = closing_distance(robot, part, grip)
    assert way == pytest.approx(0.03 - 0.5 * wide, abs=1e-5)
    tool = frame_pose(robot, model.home, "tool")
    closed = shown(after, model.home, -way)
    moved = [name for name in closed if ".finger_" in name]
    assert len(moved) == 2
    for name in moved:
        at, box = closed[name]
        gap = coal.distance(
            box,
            coal.Transform3s(at[:3, :3], at[:3, 3]),
            coal.Box(0.03, wide, 0.02),
            coal.Transform3s(tool[:3, :3], tool[:3, 3]),
            coal.DistanceRequest(),
            coal.DistanceResult(),
        )
        assert gap == pytest.approx(0.0, abs=2e-5)
        seen = (inverse(tool) @ at)[:3, 3] - (inverse(tool) @ opened[name][0])[:3, 3]
        assert seen[[0, 2]] == pytest.approx([0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("model", [box_and_hand(), cup()])
def test_tools_without_fingers_stay_as_they_are(model: RobotModel) -> None:
    _, before, after = descriptions(model)
    assert before == after


def test_fingers_that_a_robot_comes_with_stay_its_own() -> None:
    _, before, after = descriptions(robot_model("panda"))
    assert before == after
