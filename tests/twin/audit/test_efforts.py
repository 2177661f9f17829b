"""Efforts of a run: those of a pendulum by its equation of motion, and the work that lifting takes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planning.cell.robot_model import MotionLimits
from planning.cell.shape import box_shape
from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.kinematics.kinematics import frame_pose
from planning.robots.registry import robot_model
from planning.transforms import from_rpy, translation
from tests.twin.audit.swings import states_of, swing
from twin.audit.limit_checks import effort_violations
from twin.audit.motion.efforts import efforts_of_run, greatest_efforts
from twin.audit.motion.executed import ObjectRow, Recording, ReplayedRun

G = 9.80665
PENDULUM = """<robot name="pendulum">
<link name="base"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
<link name="arm">
  <inertial><origin xyz="0.5 0 0"/><mass value="{mass}"/>
    <inertia ixx="0" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.2"/></inertial>
  <collision><origin xyz="0.5 0 0"/><geometry><box size="0.9 0.1 0.1"/></geometry></collision>
</link>
<joint name="turn" type="{kind}"><parent link="base"/><child link="arm"/>
  <axis xyz="0 -1 0"/>
  <limit lower="-3" upper="3" velocity="9" effort="100"/></joint>
</robot>"""


def limited(robot: PlacedRobot) -> PlacedRobot:
    free = np.full(robot.model.dof, np.inf)
    return replace(robot, limits=MotionLimits(free, free, free))


def pendulum(folder: Path, kind: str = "revolute", mass: float = 4.0) -> PlacedRobot:
    path = folder / f"{kind}.urdf"
    path.write_text(PENDULUM.format(kind=kind, mass=mass))
    model = robot_model(str(path))
    # Turned about the upright axis, and elsewhere: neither changes anything.
    base = from_rpy((1.0, 2.0, 3.0), (0.0, 0.0, 0.7))
    return limited(PlacedRobot("one", model, base, np.zeros(1)))


@pytest.mark.parametrize("kind", ["revolute", "continuous"])
@pytest.mark.parametrize("load", [0.0, 3.0])
def test_efforts_of_a_pendulum(load: float, kind: str, tmp_path: Path) -> None:
    """tau = (I + m l^2) a + m g l cos(q), and the same for what is in hand from the middle on."""
    robot = pendulum(tmp_path, kind)
    rows = swing(20.0, 0.25)
    shape = box_shape("part", (0.2, 0.1, 0.3))
    part = CellObject("part", "part", shape, np.eye(4), mass=load)
    grip = np.linalg.inv(robot.model.flange) @ translation(1.0, 0.0, 0.0)
    taken = 0.4
    moves = (
        ObjectRow(0.0, "part", None, np.eye(4)),
        ObjectRow(taken, "part", "one", grip),
    )
    recording = Recording({"one": rows}, moves, float(rows.t[-1]))
    cell = Workcell((robot,), (), (part,))
    own = efforts_of_run(ReplayedRun(cell, recording))["one"]
    times, efforts = own.t, own.effort
    assert np.max(np.diff(times)) <= 0.01 + 1e-12
    inertia, lever = 0.2 + 4.0 * 0.5**2, 4.0 * 0.5
    inside = load * (0.2**2 + 0.3**2) / 12.0
    after = times > taken
    # Of the two samples at the change the second is with the part.
    (both,) = np.nonzero(times == taken)
    assert len(both) == 2
    after[both[1]] = True
    q, _, a = states_of(rows, times)
    loaded = np.where(after, load, 0.0)
    moment = inertia + np.where(after, inside, 0.0) + loaded
    wanted = moment * a + (lever + loaded) * G * np.cos(q)
    assert np.allclose(efforts[:, 0], wanted, rtol=0.0, atol=1e-9)
    (found,) = greatest_efforts(cell, {"one": own})
    assert (found.robot, found.joint, found.limit) == ("one", "turn", 100.0)
    assert found.effort == pytest.approx(wanted[np.argmax(np.abs(wanted))])
    assert found.share == pytest.approx(np.max(np.abs(wanted)) / 100.0)
    assert found.unweighed == (() if load else ("part",))


@pytest.mark.parametrize("name", ["ur5e", "panda"])
def test_lifting_takes_the_work_that_the_height_is_worth(name: str) -> None:
    """From rest to rest, the difference of work with and without a part is m g h."""
    model = robot_model(name)
    base = from_rpy((0.2, 0.0, 0.5), (0.3, -0.2, 1.0))
    robot = limited(PlacedRobot("one", model, base, model.home))
    way = np.linspace(0.5, -0.4, model.dof) / swing(2.0, 0.5).q[-1]
    rows = swing(2.0, 0.5, way, model.home)
    part = CellObject(
        "part", "part", box_shape("part", (0.1, 0.2, 0.3)), np.eye(4), 2.5
    )
    grip = from_rpy((0.02, -0.05, 0.1), (0.4, 0.3, 0.2))
    work = []
    for moves in ((), (ObjectRow(0.0, "part", "one", grip),)):
        recording = Recording({"one": rows}, moves, float(rows.t[-1]))
        cell = Workcell((robot,), (), (part,))
        own = efforts_of_run(ReplayedRun(cell, recording))["one"]
        power = own.effort @ (way / way[0]) * states_of(rows, own.t)[1]
        work.append(np.trapezoid(power, own.t))
    ends = [(frame_pose(robot, q) @ grip)[2, 3] for q in (rows.q[0], rows.q[-1])]
    lifted = 2.5 * G * (ends[1] - ends[0])
    assert abs(lifted) > 0.2
    assert work[1] - work[0] == pytest.approx(lifted, rel=1e-3)


def test_nothing_is_told_without_masses_or_limits(tmp_path: Path) -> None:
    recording = Recording({"one": swing(20.0, 0.25)}, (), 1.0)
    bare = pendulum(tmp_path, mass=0.0)
    assert efforts_of_run(ReplayedRun(Workcell((bare,), (), ()), recording)) == {}
    robot = replace(pendulum(tmp_path), limits=None)
    assert efforts_of_run(ReplayedRun(Workcell((robot,), (), ()), recording)) == {}


@pytest.mark.parametrize(
    ("limit", "kinds"),
    [(1.0001, []), (0.999, ["joint-effort"])],
)
def test_more_than_a_joint_can_exert_is_found(
    limit: float, kinds: list[str], tmp_path: Path
) -> None:
    """What is asked for is greatest where the arm is raised from rest, a little after it begins."""
    robot, recording, most = raised(tmp_path)
    cell = Workcell((with_effort(robot, most * limit),), (), ())
    replay = ReplayedRun(cell, recording)
    found = list(effort_violations(replay, efforts_of_run(replay)))
    assert [v.kind for v in found] == kinds
    for v in found:
        assert (v.first, v.second) == ("one", "turn")
        assert 0.0 < v.t_start <= v.t_end < 0.5
        assert v.detail.startswith(
            f"{most:.6g} N m, its limit is {most * limit:.6g} N m"
        )


def test_what_gravity_alone_takes_is_no_violation(tmp_path: Path) -> None:
    robot, recording, _ = raised(tmp_path)
    # Less than what it takes to hold the arm where it begins.
    cell = Workcell((with_effort(robot, 0.5 * 4.0 * 0.5 * G),), (), ())
    replay = ReplayedRun(cell, recording)
    own = efforts_of_run(replay)
    (most,) = greatest_efforts(cell, own)
    assert most.share > 2.0
    assert not list(effort_violations(replay, own))


def raised(folder: Path) -> tuple[PlacedRobot, Recording, float]:
    """A pendulum that is raised from the horizontal, and the most that this takes."""
    robot = pendulum(folder)
    rows = swing(20.0, 0.25)
    q, _, a = states_of(rows, np.linspace(0.0, 1.0, 10_001))
    most = np.max(1.2 * a + 2.0 * G * np.cos(q))
    return robot, Recording({"one": rows}, (), 1.0), float(most)


def with_effort(robot: PlacedRobot, effort: float) -> PlacedRobot:
    assert robot.model.drives is not None
    drives = replace(robot.model.drives, effort=np.array([effort]))
    return replace(robot, model=replace(robot.model, drives=drives))
