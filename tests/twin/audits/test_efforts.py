"""Efforts and tool speeds of a run, by equations of motion and by differences of where the tool is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planning.cell.motion_limits import MotionLimits
from planning.cell.shape import box_shape
from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.kinematics.kinematics import frame_pose
from planning.robots.registry import robot_model
from planning.transforms import from_rpy, translation
from tests.twin.audits.audit_cell import brick
from tests.twin.audits.swings import states_of, swing
from twin.audits.case import Violation
from twin.audits.motion.efforts import (
    ToolSpeeds,
    efforts_of_run,
    greatest_efforts,
    tool_speeds_of_run,
)
from twin.audits.motion.executed import ObjectRow, Recording, ReplayedRun
from twin.audits.motion_limits import (
    effort_violations,
    limit_violations,
    tool_speed_violations,
)

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


TAKEN_S = 0.5
"""When the part is taken, in the middle of a swing of 1 s: at its greatest speed."""


def swung(name: str, limits: MotionLimits) -> tuple[Workcell, Recording]:
    """All joints of a robot swing, and halfway it takes a part."""
    model = robot_model(name)
    base = from_rpy((0.3, -0.2, 0.1), (0.2, 0.4, 1.0))
    robot = PlacedRobot("one", model, base, model.home, limits=limits)
    rows = swing(10.0, 0.25, np.linspace(1.0, -0.6, model.dof), model.home)
    part = brick("part", 1.0, 0.0)
    moves = (
        ObjectRow(0.0, "part", None, part.start),
        ObjectRow(TAKEN_S, "part", "one", np.eye(4)),
    )
    return Workcell((robot,), (), (part,)), Recording({"one": rows}, moves, 1.0)


def limits_of(dof: int, free: float, loaded: float) -> MotionLimits:
    wide = np.full(dof, np.inf)
    return MotionLimits(wide, wide, wide, tool_speed=free, loaded_tool_speed=loaded)


def differences(cell: Workcell, recording: Recording, times: np.ndarray) -> np.ndarray:
    """Speeds of the tool's frame, by where it is a little before and a little after."""
    robot, rows = cell.robots[0], recording.robots["one"]
    step = 1e-5
    at = [
        np.array([frame_pose(robot, q, "tool")[:3, 3] for q in rows.at(times + late)])
        for late in (-step, step)
    ]
    return np.asarray(np.linalg.norm(at[1] - at[0], axis=1) / (2 * step))


@pytest.mark.parametrize("name", ["gp4", "ur5e", "mobile-manipulator"])
def test_speeds_are_those_of_where_the_tool_is(name: str) -> None:
    dof = robot_model(name).dof
    cell, recording = swung(name, limits_of(dof, 100.0, 50.0))
    parts = list(tool_speeds_of_run(ReplayedRun(cell, recording)))
    assert [(own.loaded, own.limit) for own in parts] == [(False, 100.0), (True, 50.0)]
    for own in parts:
        inside = (own.t > 1e-4) & (own.t < 1.0 - 1e-4)
        wanted = differences(cell, recording, own.t[inside])
        assert np.allclose(own.speed[inside], wanted, rtol=1e-5, atol=1e-6)
        assert np.max(np.diff(own.t)) <= 0.01 + 1e-12


def found_with(name: str, free: float, loaded: float) -> list[Violation]:
    cell, recording = swung(name, limits_of(robot_model(name).dof, free, loaded))
    return list(tool_speed_violations(tool_speeds_of_run(ReplayedRun(cell, recording))))


def test_a_tool_that_is_faster_than_it_may_be_is_found() -> None:
    cell, recording = swung("ur5e", limits_of(6, 100.0, 100.0))
    own: list[ToolSpeeds] = list(tool_speeds_of_run(ReplayedRun(cell, recording)))
    empty, loaded = (float(part.speed.max()) for part in own)
    assert found_with("ur5e", 1.0001 * max(empty, loaded), loaded * 1.0001) == []
    (slow,) = found_with("ur5e", empty * 0.999, np.inf)[:1]
    assert (slow.kind, slow.first, slow.second) == ("tool-speed", "one", "tool")
    assert "with nothing in hand" in slow.detail
    assert slow.t_start <= TAKEN_S
    (held,) = found_with("ur5e", np.inf, loaded * 0.999)
    assert "with a part in hand" in held.detail
    assert held.t_start >= TAKEN_S
    assert found_with("ur5e", np.inf, np.inf) == []


@pytest.mark.parametrize("share", [0.999, 1.0001])
def test_joint_speeds_that_add_up_to_too_much_are_found(share: float) -> None:
    cell, recording = swung("ur5e", limits_of(6, np.inf, np.inf))
    speeds = recording.robots["one"].v
    assert speeds is not None
    robot = cell.robots[0]
    assert robot.limits is not None
    most = float(np.abs(speeds).sum(axis=1).max()) * share
    tight = replace(robot, limits=replace(robot.limits, sum_of_speeds=most))
    found = list(
        limit_violations(ReplayedRun(replace(cell, robots=(tight,)), recording))
    )
    seen = [(v.kind, v.first, v.second) for v in found]
    assert seen == ([("joint-speed", "one", "all joints")] if share < 1.0 else [])
