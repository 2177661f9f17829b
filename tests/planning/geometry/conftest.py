"""A small arm of boxes whose every number is at hand, and cells made of it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from planning.cell.cover import box_body
from planning.cell.robot_model import KinematicChain, LinkPart, RobotModel
from planning.cell.workcell import PlacedRobot
from planning.transforms import from_rpy, translation

ArmMaker = Callable[..., PlacedRobot]


@pytest.fixture
def make_arm() -> ArmMaker:
    """Return a maker of arms: a slide, then three hinges about z, y and x, a box each."""

    def make(name: str = "arm", base: np.ndarray | None = None) -> PlacedRobot:
        placement = np.array(
            [
                from_rpy((0.0, 0.0, 0.1), (0.1, 0.0, 0.0)),
                from_rpy((0.05, 0.0, 0.1), (0.0, 0.2, 0.0)),
                from_rpy((0.25, 0.0, 0.0), (0.0, 0.0, 0.3)),
                from_rpy((0.2, 0.02, 0.0), (0.0, 0.0, 0.0)),
            ]
        )
        axis = np.array([[0.0, 1, 0], [0, 0, 1], [0, 1, 0], [1, 0, 0]])
        sizes = [
            (0.1, 0.1, 0.1),
            (0.25, 0.05, 0.05),
            (0.2, 0.04, 0.04),
            (0.1, 0.03, 0.02),
        ]
        parts = []
        for joint, size in enumerate(sizes):
            body = box_body(f"link{joint}", np.array(size))
            shift = np.array([size[0] / 2, 0.0, 0.0])
            capsules = type(body.capsules)(
                body.capsules.start + shift,
                body.capsules.end + shift,
                body.capsules.radius,
            )
            moved = type(body)(body.name, body.vertices + shift, capsules)
            parts.append(LinkPart(joint, "tool" if joint == 3 else "arm", moved))
        close = {(i, i + 1) for i in range(3)} | {(0, 2)}
        model = RobotModel(
            name="toy",
            urdf=Path("toy.urdf"),
            package_dirs=(),
            joint_names=("slide", "turn", "lift", "roll"),
            lower=np.array([-0.3, -3.0, -2.5, -3.0]),
            upper=np.array([0.3, 3.0, 2.5, 3.0]),
            velocity=np.ones(4),
            chain=KinematicChain(
                placement, axis, np.array([True, False, False, False])
            ),
            flange=translation(0.1, 0.0, 0.0),
            frames={},
            parts=tuple(parts),
            never_collide=frozenset(close),
            home=np.zeros(4),
        )
        return PlacedRobot(name, model, np.eye(4) if base is None else base, model.home)

    return make
