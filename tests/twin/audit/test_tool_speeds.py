"""Speeds of tools in a run, against differences of where the planner says that the tool is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planning.cell.robot_model import MotionLimits
from planning.cell.workcell import PlacedRobot, Workcell
from planning.kinematics.kinematics import frame_pose
from planning.robots.registry import robot_model
from planning.transforms import from_rpy
from tests.twin.audit.audit_cell import brick
from tests.twin.audit.swings import swing
from twin.audit.limit_checks import limit_violations, tool_speed_violations
from twin.audit.motion.efforts import ToolSpeeds, tool_speeds_of_run
from twin.audit.motion.executed import ObjectRow, Recording, ReplayedRun
from twin.audit.violation import Violation

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
