"""Arms and grippers of vendors, from their files as they are published to an audited run."""

import re
from pathlib import Path

import numpy as np
import pytest

from planning.robots.registry import ROBOTS
from planning.transforms import inverse
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.planning.robots.descriptions.test_mjcf import HAND
from tests.planning.robots.descriptions.vendors import robotiq, ur5e, vendor_file
from tests.twin.scenarios.executed import built
from twin.checks.tools import finger_gap

CELL = """\
version: 1
name: vendors
cell:
  tools:
{tools}
  robots:
{robots}
  fixtures:
    - {{name: table, size_m: [1.6, 1.2, 0.04], pose: {{xyz_m: [0, 0, -0.025]}}}}
assembly:
  kind: assembly
  grips: {{depth_m: 0.02, positions: 3, opening_m: 0.08}}
  parts:
    - {{name: a, size_m: [0.06, 0.04, 0.04], start: {{xyz_m: [-0.1, 0.35, 0.015]}}, goal: {{xyz_m: [0, 0.1, 0.015]}}}}
    - {{name: b, size_m: [0.06, 0.04, 0.04], start: {{xyz_m: [0.1, 0.35, 0.015]}}, goal: {{xyz_m: [0, 0.1, 0.055]}}}}
    - {{name: c, size_m: [0.06, 0.04, 0.04], start: {{xyz_m: [-0.1, -0.35, 0.015]}}, goal: {{xyz_m: [0, -0.1, 0.015]}}}}
    - {{name: d, size_m: [0.06, 0.04, 0.04], start: {{xyz_m: [0.1, -0.35, 0.015]}}, goal: {{xyz_m: [0, -0.1, 0.055]}}}}
    - {{name: e, size_m: [0.06, 0.04, 0.04], start: {{xyz_m: [0.1, -0.45, 0.015]}}, goal: {{xyz_m: [0, 0.1, 0.095]}}}}
  steps: [a, b, c, d, e]
planning: {{speed_model: joint}}
execution:
  skills: {{pick: {{kind: fixed, value_s: 1.5}}, place-down: {{kind: fixed, value_s: 1.5}}}}
"""

TWO_FINGER = """\
    hand:
      description: {file}
      joints: {{finger_joint: 0.3}}
      tcp: {{xyz_m: [0, 0, 0.145]}}
      closing: x
      opening_m: 0.085
"""

ARMS = """\
    - {{name: left, model: {file}, tool: hand, base: {{xyz_m: [-{away}, 0, 0]}}, {more}}}
    - name: right
      model: {file}
      tool: hand
      base: {{xyz_m: [{away}, 0, 0], rpy_deg: [0, 0, 180]}}
      {lines}
"""


def arms(file: object, away: float, *more: str) -> str:
    return ARMS.format(
        file=file, away=away, more=", ".join(more), lines="\n      ".join(more)
    )


def done(folder: Path, tools: str, robots: str) -> TemporalPlanGraph:
    """Return the plan of the five parts, once check, proof and audit are content."""
    text = CELL.format(tools=tools.rstrip(), robots=robots.rstrip())
    return built(folder, text).tpg


def require_between_fingers(tpg: TemporalPlanGraph) -> None:
    """Oracle: whatever is held is where the fingers are, and spans the axis they close along."""
    held = [h for task in tpg.tasks for h in task.handlings if h.holder is not None]
    assert len(held) >= 5
    for handling in held:
        model = tpg.cell.robot(str(handling.holder)).model
        tool = model.frames["tool"]
        part = inverse(tool) @ handling.pose
        gap = finger_gap(model, tool)
        assert gap is not None
        assert abs(part[1, 3]) < 1e-6
        width = float(np.abs(part[1, :3]) @ tpg.cell.object(handling.object).size)
        assert width <= gap + 1e-9
        # The tcp is in the part.
        centre = inverse(part)[:3, 3]
        assert np.all(
            np.abs(centre) <= 0.5 * tpg.cell.object(handling.object).size + 1e-9
        )


HOME = "home_deg: [0, -100, 110, -100, -90, 0]"


@pytest.mark.nightly
def test_two_ur5e_with_grippers_of_robotiq(tmp_path: Path) -> None:
    """No file is edited; fingers of six joints that follow each other, tool0 taken for the flange."""
    tpg = done(tmp_path, TWO_FINGER.format(file=robotiq()), arms(ur5e(), 0.45, HOME))
    assert {robot.model.flange_link for robot in tpg.cell.robots} == {"tool0"}
    require_between_fingers(tpg)


@pytest.mark.expensive
def test_two_ur3e_with_grippers_of_schunk(tmp_path: Path) -> None:
    """Two sliding fingers, which nobody holds: they stay where they are at zero."""
    ur3e = vendor_file("arms/ur3e/ur3e.urdf")
    gripper = vendor_file("grippers/schunk_egk40_magneto/schunk_egk40_magneto.urdf")
    tools = f"""\
    hand: {{description: {gripper}, tcp: {{xyz_m: [0, 0, 0.14]}}, closing: x, opening_m: 0.08}}
"""
    done(tmp_path, tools, arms(ur3e, 0.36, HOME))


@pytest.mark.nightly
def test_the_panda_of_pybullet_as_anyone_has_it(tmp_path: Path) -> None:
    """Its fingers belong to the arm's description: 'joints' holds them, and no tool is mounted."""
    data = pytest.importorskip("pybullet_data")
    file = Path(data.getDataPath(), "franka_panda", "panda.urdf")
    more = (
        "flange: panda_link8",
        "joints: {panda_finger_joint1: 0.04, panda_finger_joint2: 0.04}",
        "frames: {tool: {xyz_m: [0, 0, 0.105], rpy_deg: [0, 0, -45]}}",
        "home_deg: [0, -45, 0, -135, 0, 90, 45]",
    )
    robots = (
        arms(file, 0.55, *more)
        .replace("tool: hand, ", "")
        .replace("      tool: hand\n", "")
    )
    tpg = done(
        tmp_path,
        "    spare: {shapes: [{box: [0.1, 0.1, 0.1]}], tcp: {xyz_m: [0, 0, 0.1]}}",
        robots,
    )
    assert {robot.model.dof for robot in tpg.cell.robots} == {7}
    assert {robot.model.name for robot in tpg.cell.robots} == {"panda-file"}
    assert "panda" in ROBOTS
    require_between_fingers(tpg)


@pytest.mark.expensive
def test_the_iiwa_of_pybullet_with_a_gripper_in_mjcf(tmp_path: Path) -> None:
    data = pytest.importorskip("pybullet_data")
    hand = re.sub(r'<body name="nail".*?</body>', "", HAND, flags=re.DOTALL)
    (tmp_path / "hand.xml").write_text(hand)
    file = Path(data.getDataPath(), "kuka_iiwa", "model.urdf")
    tools = """\
    hand:
      description: hand.xml
      mount: {xyz_m: [0, 0, 0.045]}
      joints: {right: 0.035, left: 0.035}
      tcp: {xyz_m: [0, 0, 0.115], rpy_deg: [0, 0, 45]}
      opening_m: 0.07
"""
    more = ("home_deg: [0, -20, 0, -110, 0, 90, 0]", "limits: {velocity: 1.5}")
    tpg = done(tmp_path, tools, arms(file, 0.65, *more))
    require_between_fingers(tpg)
