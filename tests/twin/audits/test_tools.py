"""The audit sees tools of cells: their bodies from the description, how far their fingers open.

The audit sees processes that were done where they belong, however short they were.
"""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planning.cell.robot_model import RobotModel, ToolGrip
from planning.cell.shape import Box, Capsule, Cylinder, Element, box_shape
from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.kinematics.kinematics import frame_pose
from planning.robots.descriptions.fitting import Fitting, Tool
from planning.robots.registry import robot_model
from planning.tasks.task import Task
from planning.transforms import Transform, from_rpy, inverse, translation
from scheduling.graph.plan_files import load_plan, save_plan
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.planning.robots.descriptions.vendors import GRIPPER
from tests.twin.audits.audit_cell import TOP, HandWrittenRun, reach, two_arm_cell
from twin.audits.audit import audit_run
from twin.audits.case import AuditCase
from twin.audits.expectations import Expectations, ExpectedProcess
from twin.audits.motion.executed import Recording, RobotRows
from twin.audits.processes import process_violations
from twin.audits.worlds.engines import second_world
from twin.audits.worlds.world import AuditWorld

PART = (0.05, 0.03, 0.04)


@pytest.fixture
def model(tmp_path: Path) -> RobotModel:
    """A UR5e whose fingers are held 60 mm apart and open to 80 mm."""
    path = tmp_path / "gripper.urdf"
    path.write_text(GRIPPER)
    tool = Tool(
        name="hand",
        description=path,
        held={"squeeze": 0.03},
        grip=ToolGrip((0.0, 0.08), "hand"),
    )
    return robot_model("ur5e", None, Fitting(tool=tool))


def holding(model: RobotModel, size: tuple[float, ...]) -> HandWrittenRun:
    """A part between the fingers of a robot that takes it at 1 s and stands still."""
    robot = PlacedRobot("arm", model, np.eye(4), model.home)
    at = frame_pose(robot, model.home, "tool")
    part = CellObject("part", "part", box_shape("part", size), at)
    run = HandWrittenRun(Workcell((robot,), (), (part,)))
    run.move("arm", [0.0, 2.0], np.stack([model.home] * 2))
    flange = frame_pose(robot, model.home, "flange")
    run.put(1.0, "part", "arm", inverse(flange) @ at)
    return run


def grips(run: HandWrittenRun, folder: Path) -> list[str]:
    run.write(folder)
    report = audit_run(folder, wanted=Expectations(opening_m=0.5), finished=False)
    return [v.detail for v in report.violations if v.kind == "grip"]


def test_what_is_wider_than_the_fingers_open_is_seen(
    model: RobotModel, tmp_path: Path
) -> None:
    """Fingers close along y of the tool frame: 30 mm there are held, 90 mm are not."""
    assert grips(holding(model, PART), tmp_path / "fits") == []
    (words,) = grips(holding(model, (0.05, 0.09, 0.04)), tmp_path / "wide")
    assert "is 90.00 mm wide between the fingers of hand" in words
    assert "open to 80.00 mm" in words
    turned = replace(
        model,
        frames={"tool": model.frames["tool"] @ from_rpy((0, 0, 0), (0, 0, np.pi / 2))},
    )
    wide = holding(turned, (0.05, 0.09, 0.04))
    assert len(grips(wide, tmp_path / "turned")) == 1  # its frame turns with it


def test_what_hangs_beside_the_fingers_is_seen(
    model: RobotModel, tmp_path: Path
) -> None:
    """The tool tells how far fingers close, whatever the assembly says."""
    beside = replace(model, frames={"tool": translation(0.0, 0.0, 0.24)})
    (words,) = grips(holding(beside, PART), tmp_path / "beside")
    assert "is held" in words
    assert "closes by 25.00 mm" in words


def test_the_tool_is_in_the_audits_own_world(model: RobotModel) -> None:
    """Oracle: the fingers are 60 mm apart, and a box between them has 15 mm on either side."""
    robot = PlacedRobot("arm", model, np.eye(4), model.home)
    part = CellObject("part", "part", box_shape("part", PART), np.eye(4))
    world = AuditWorld(Workcell((robot,), (), (part,)))
    world.configure(0, model.home)
    world.place(world.objects[0], frame_pose(robot, model.home, "tool"))
    gaps = {
        shape.detail: world.distance(shape, world.objects[0], 1.0)
        for shape in world.robot_shapes
        if shape.entity == "arm/tool"
    }
    assert set(gaps) == {"arm/hand.palm", "arm/hand.left", "arm/hand.right"}
    assert gaps["arm/hand.left"] == pytest.approx(0.015, abs=2e-4)
    assert gaps["arm/hand.right"] == pytest.approx(0.015, abs=2e-4)
    assert gaps["arm/hand.palm"] == pytest.approx(0.02, abs=2e-4)


def test_a_plan_takes_the_tool_along(model: RobotModel, tmp_path: Path) -> None:
    """All of it is in the folder of the plan: tool, flange, opening and limits."""
    run, moved = tmp_path / "run", tmp_path / "elsewhere"
    save_plan(holding(model, PART).tpg(), run)
    shutil.rmtree(model.urdf.parent)  # what this program keeps while it runs
    shutil.move(run, moved)
    found = load_plan(moved).cell.robots[0].model
    assert found.urdf.is_relative_to(moved)
    assert (found.name, found.flange_link, found.grip) == (
        model.name,
        model.flange_link,
        model.grip,
    )
    assert np.array_equal(found.flange, model.flange)
    assert np.array_equal(found.velocity, model.velocity)
    assert found.frames.keys() == model.frames.keys()
    for ours, theirs in zip(model.parts, found.parts, strict=True):
        assert ours.group == theirs.group
        assert np.allclose(ours.body.vertices, theirs.body.vertices, atol=1e-12)


def test_a_tool_of_shapes_is_what_it_is() -> None:
    """A box, a cylinder and a capsule, against arithmetic."""
    shapes = (
        Element(Box((0.04, 0.06, 0.1)), translation(0.0, 0.0, 0.05)),
        Element(Cylinder(0.01, 0.2), translation(0.0, 0.0, 0.2)),
        Element(Capsule(0.015, 0.03), translation(0.1, 0.0, 0.05)),
    )
    tool = Tool(name="probe", shapes=shapes, tcp=translation(0.0, 0.0, 0.3))
    model = robot_model("ur5e", None, Fitting(tool=tool))
    robot = PlacedRobot("arm", model, np.eye(4), model.home)
    part = CellObject("part", "part", box_shape("part", (0.02, 0.02, 0.02)), np.eye(4))
    world = AuditWorld(Workcell((robot,), (), (part,)))
    world.configure(0, model.home)
    flange = frame_pose(robot, model.home, "flange")

    def nearest(x: float, y: float, z: float) -> float:
        world.place(world.objects[0], flange @ translation(x, y, z))
        return min(
            world.distance(shape, world.objects[0], 1.0)
            for shape in world.robot_shapes
            if shape.entity == "arm/tool"
        )

    assert nearest(0.0, 0.0, 0.35) == pytest.approx(
        0.04, abs=2e-4
    )  # the cylinder's end
    assert nearest(0.0, 0.1, 0.05) == pytest.approx(0.06, abs=2e-4)  # the box
    assert nearest(0.1, 0.0, 0.12) == pytest.approx(0.03, abs=2e-4)  # the capsule's top
    assert nearest(0.16, 0.0, 0.05) == pytest.approx(0.035, abs=2e-4)  # its side


def test_a_description_on_one_long_line_is_read(tmp_path: Path) -> None:
    """Bullet reads lines of 8 kB: what is longer it breaks where it happens to be."""
    links = "".join(
        f'<link name="plate{k}"><collision><geometry><box size="0.01 0.01 0.01"/></geometry>'
        f'</collision></link><joint name="fix{k}" type="fixed"><parent link="palm"/>'
        f'<child link="plate{k}"/><origin xyz="0 0 0.0{k:02d}"/></joint>'
        for k in range(25)
    )
    path = tmp_path / "gripper.urdf"
    path.write_text(GRIPPER.replace("</robot>", links + "</robot>").replace("\n", " "))
    tool = Tool(name="hand", description=path)
    long = robot_model("ur5e", None, Fitting(tool=tool))
    flat = tmp_path / "flat.urdf"
    flat.write_text(" ".join(long.urdf.read_text().split("\n")))
    arm = robot_model(str(flat))
    robot = PlacedRobot("arm", arm, np.eye(4), arm.home)
    pytest.importorskip("pybullet")
    world = AuditWorld(Workcell((robot,), (), ()))
    assert len(world.robot_shapes) >= 25
    second = second_world(world, "pybullet")
    assert second is not None
    second.close()


HIGH = TOP + 0.1


def said(place: Transform, *, passed: bool = True) -> list[str]:
    """What the audit says of a process of 0 s, done where ``left`` is at 2 s of its way and back.

    Args:
        place: where it is wanted.
        passed: whether the run goes on behind it.
    """
    cell = two_arm_cell()
    there = reach(cell, "left", 0.42, 0.0, HIGH)
    home = cell.robot("left").home
    run = HandWrittenRun(cell)
    run.move("left", [0.0, 2.0, 2.0, 4.0], np.stack([home, there, there, home]))
    plan: TemporalPlanGraph = run.tpg()
    kinds = ("transit", "snap", "transit")
    tasks = tuple(
        Task(k, "left", kind, 1, kind, plan.chains[0].waypoints[k : k + 1])
        for k, kind in enumerate(kinds)
    )
    chain = replace(plan.chains[0], task=np.arange(3))
    plan = replace(plan, tasks=tasks, chains=(chain,))
    # Within limits times rise: what takes no time has no row.
    kept = [0, 1, 3] if passed else [0, 1]
    t, q = run.motions["left"]
    rows = {"left": RobotRows(t[kept], q[kept], np.array(kept) - 1)}
    still = cell.robot("right").home[None]
    rows["right"] = RobotRows(np.zeros(1), still, np.full(1, -1))
    snap = ExpectedProcess("snap in", "snap", None, place, (np.eye(4),))
    recording, wanted = Recording(rows, (), 4.0), Expectations(processes=(snap,))
    case = AuditCase(AuditWorld(cell), plan, recording, wanted)
    return [violation.detail for violation in process_violations(case)]


@pytest.mark.parametrize(
    ("place", "words"),
    [
        (translation(0.42, 0.0, HIGH), []),
        (
            translation(0.45, 0.0, HIGH),
            ["its tool comes no nearer than 30.00 mm to its place"],
        ),
    ],
)
def test_what_takes_no_time_is_done_where_it_is_passed(
    place: Transform, words: list[str]
) -> None:
    assert said(place) == words


def test_what_is_not_come_to_is_not_done() -> None:
    assert said(translation(0.42, 0.0, HIGH), passed=False) == ["was not done"]
