"""Small teams for tests: boxes that slide on a plane, and that fly with a suction cup below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from planning.cell.robot_model import RobotModel
from planning.cell.shape import box_shape
from planning.cell.workcell import (
    CellObject,
    Clearances,
    Fixture,
    PlacedRobot,
    Workcell,
)
from planning.robots.descriptions.urdf_file import UrdfOptions
from planning.robots.load_urdf import load_urdf
from planning.transforms import Array, rotation, translation

SPEED = 0.5


_FOLDER = TemporaryDirectory()

_LINK = """
  <link name="{name}">
    <inertial><mass value="1"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>{shapes}
  </link>"""

_SHAPE = """
    <collision><origin xyz="{at}"/><geometry><box size="{size}"/></geometry></collision>"""

_JOINT = """
  <joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
    <origin xyz="{at}"/><axis xyz="{axis}"/>
    <limit lower="{lower}" upper="{upper}" velocity="{velocity}" effort="1"/></joint>"""

Box = tuple[str, str]
"""Size and place of a box in its link, as a URDF writes them."""


@dataclass(frozen=True)
class _Joint:
    """A joint of a toy and the boxes that it moves."""

    kind: str
    axis: str
    link: str
    boxes: tuple[Box, ...] = ()
    at: str = "0 0 0"
    reach: float = 4.0
    velocity: float = SPEED


def _model(name: str, joints: Sequence[_Joint], flange: Array) -> RobotModel:
    """Write a description of boxes and read it as any other robot's."""
    text = _LINK.format(name="ground", shapes="")
    parent = "ground"
    for k, joint in enumerate(joints):
        shapes = "".join(_SHAPE.format(size=s, at=at) for s, at in joint.boxes)
        text += _LINK.format(name=joint.link, shapes=shapes)
        text += _JOINT.format(
            name=f"joint_{k}",
            kind=joint.kind,
            parent=parent,
            child=joint.link,
            at=joint.at,
            axis=joint.axis,
            lower=-joint.reach,
            upper=joint.reach,
            velocity=joint.velocity,
        )
        parent = joint.link
    path = Path(_FOLDER.name, f"{name}.urdf")
    path.write_text(f'<robot name="{name}">{text}\n</robot>')
    return load_urdf(
        path,
        UrdfOptions(name=name, flange_offset=flange, tool_links=("cup", "lower")),
    )


@cache
def slider(size: tuple[float, float, float] = (0.3, 0.3, 0.3)) -> RobotModel:
    """A box on the plane z = 0: x and y."""
    x, y, z = size
    shape = (f"{x} {y} {z}", f"0 0 {z / 2}")
    return _model(
        f"slider_{x}_{y}_{z}",
        [
            _Joint("prismatic", "1 0 0", "slide"),
            _Joint("prismatic", "0 1 0", "box", (shape,)),
        ],
        translation(0.0, 0.0, z),
    )


@cache
def rover() -> RobotModel:
    """A long box on the plane that turns: x, y and yaw, and an arm of two joints on top."""
    turning = partial(_Joint, "revolute", "0 0 1", reach=3.1, velocity=1.0)
    return _model(
        "rover",
        [
            _Joint("prismatic", "1 0 0", "slide_x"),
            _Joint("prismatic", "0 1 0", "slide_y"),
            turning("chassis", (("0.6 0.3 0.3", "0 0 0.16"),)),
            turning("upper", (("0.1 0.1 0.5", "0 0 0.57"),)),
            _Joint(
                "revolute",
                "0 1 0",
                "lower",
                (("0.5 0.08 0.08", "0.25 0 0.05"),),
                at="0 0 0.83",
                reach=1.2,
            ),
        ],
        translation(0.5, 0.0, 0.05),
    )


@cache
def flyer() -> RobotModel:
    """A flying box with a suction cup below: x, y, z; the flange is the cup's mouth."""
    return _model(
        "flyer",
        [
            _Joint("prismatic", "1 0 0", "slide_x"),
            _Joint("prismatic", "0 1 0", "slide_y"),
            _Joint(
                "prismatic",
                "0 0 1",
                "cup",
                (("0.3 0.3 0.15", "0 0 0.275"), ("0.06 0.06 0.2", "0 0 0.1")),
            ),
        ],
        translation(0.0, 0.0, 0.0),
    )


def placed(name: str, model: RobotModel, home: tuple[float, ...]) -> PlacedRobot:
    return PlacedRobot(name, model, np.eye(4), np.array(home, dtype=float))


def box(
    name: str, size: tuple[float, float, float], at: tuple[float, float, float]
) -> CellObject:
    return CellObject(name, "box", box_shape(name, size), translation(*at), mass=0.1)


def fixture(
    name: str,
    size: tuple[float, float, float],
    at: tuple[float, float, float],
    turn: float = 0.0,
) -> Fixture:
    return Fixture(
        name,
        box_shape(name, size),
        translation(*at) @ rotation("z", turn),
    )


def team(
    robots: list[PlacedRobot],
    *,
    fixtures: tuple[Fixture, ...] = (),
    objects: tuple[CellObject, ...] = (),
) -> Workcell:
    return Workcell(tuple(robots), fixtures, objects, Clearances(0.001, 0.0))
