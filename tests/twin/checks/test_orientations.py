"""Orientations that chains give their tools, against what they do, and against the nearest of many that they do."""

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from planning.cell.workcell import PlacedRobot
from planning.kinematics.kinematics import frame_pose
from planning.robots.registry import robot_model
from planning.transforms import Array, from_rpy
from twin.kinds.parts.checks.orientations import can_turn, turning_axes, turning_words

CHAINS = {
    "three slides": ("sx sy sz", 0),
    "gantry with a swivel": ("sx sy sz tz", 1),
    "SCARA": ("tz tz sz tz", 1),
    "SCARA upside down": ("tz t-z sz", 1),
    "a swivel and a tilt": ("sx tz sz ty", 2),
    "two that are askew": ("ta sx sy tb", 2),
    "elbow in between": ("tz ty ty tz", 3),
    "gantry with a wrist": ("sx sy sz tz ty tz", 3),
}
AXES = {
    "x": "1 0 0",
    "y": "0 1 0",
    "z": "0 0 1",
    "-z": "0 0 -1",
    "a": "1 2 2",
    "b": "-1 0 3",
}


def chain(folder: Path, words: str) -> PlacedRobot:
    """Return a robot of slides (s) and joints that turn (t) about axes, on a base that is turned."""
    body = '<collision><geometry><box size="0.02 0.02 0.02"/></geometry></collision>'
    joints = words.split()
    text = f'<robot name="c"><link name="l0">{body}</link>'
    for k, joint in enumerate(joints):
        kind = "prismatic" if joint[0] == "s" else "revolute"
        text += (
            f'<link name="l{k + 1}">{body}</link><joint name="j{k}" type="{kind}"><parent link="l{k}"/>'
            f'<child link="l{k + 1}"/><origin xyz="0.1 0.05 0.1"/><axis xyz="{AXES[joint[1:]]}"/>'
            '<limit lower="-3" upper="3" effort="9" velocity="1"/></joint>'
        )
    path = folder / "chain.urdf"
    path.write_text(text + "</robot>")
    model = robot_model(str(path))
    home = np.linspace(-0.7, 0.9, len(joints))
    return PlacedRobot("arm", model, from_rpy((0, 0, 0), (0.3, -0.2, 1.0)), home)


def nearest(robot: PlacedRobot, wanted: Array) -> float:
    """Return by how much the nearest orientation found is away from a wanted one [rad]."""

    def away(q: Array) -> float:
        now = frame_pose(robot, q, "flange")[:3, :3]
        return float(Rotation.from_matrix(now.T @ wanted).magnitude())

    rng = np.random.default_rng(1)
    starts = rng.uniform(-3, 3, (12, robot.model.dof))
    return min(minimize(away, q, method="Nelder-Mead").fun for q in starts)


@pytest.mark.parametrize("name", CHAINS)
def test_a_chain_turns_as_its_axes_let_it(name: str, tmp_path: Path) -> None:
    words, axes = CHAINS[name]
    robot = chain(tmp_path, words)
    assert len(turning_axes(robot)) == axes
    rng = np.random.default_rng(0)
    for q in rng.uniform(-3, 3, (20, robot.model.dof)):
        assert can_turn(robot, "flange", frame_pose(robot, q, "flange")[:3, :3])
    if axes > 2:
        return
    assert ("slides turn nothing" in turning_words(robot, "flange")) == (axes == 0)
    for wanted in Rotation.random(4, random_state=2).as_matrix():
        assert not can_turn(robot, "flange", wanted)
        assert nearest(robot, wanted) > 0.002
