"""Limits in executed runs, of joints' efforts and tools' speeds: pinocchio with the tables that a run leaves."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from planning.transforms import Transform
from scheduling.corners.corners import round_corners
from scheduling.graph.temporal_plan_graph import (
    BY_EFFORT,
    BY_JOINTS,
    BY_TOOL_SPEED,
    TemporalPlanGraph,
)
from scheduling.motion_times import assign_node_times
from scheduling.slowed_motions import describe_overloaded_joints, slowed_motions
from tests.planning.timing.drawn_arm import PinocchioArm
from tests.shipped_runs import ShippedRuns
from twin.audits.motion.executed import Recording, read_recording
from twin.engine.engine import Simulator
from twin.recorders.run_tables import write_motion
from twin.runs.cubic_motion import cubic_at
from twin.scenario.sections.scenario import Scenario
from twin.trial.simulation import scenario_execution
from twin.uncertainty.disturbances import Disturbances, Stalls

NO_STALLS = Stalls()
MANY_STALLS = Stalls(count_per_robot=5, duration_s=(0.1, 2.0))
CASES = pytest.mark.parametrize(
    ("corners", "stalls"),
    list(product(["rest", "smooth"], [NO_STALLS, MANY_STALLS])),
    ids=["rest, calm", "rest, late", "smooth, calm", "smooth, late"],
)


def recorded(
    folder: Path, scenario: Scenario, tpg: TemporalPlanGraph, stalls: Stalls
) -> Recording:
    """Execute a graph of a shipped scenario with these disturbances only; read what is written of it."""
    model = replace(
        scenario_execution(scenario), disturbances=Disturbances(stalls=stalls)
    )
    run = Simulator(tpg, model).run(seed=3)
    assert run.outcome == "completed"
    write_motion(folder, tpg, run)
    return read_recording(folder, tpg.cell)


def with_corners(tpg: TemporalPlanGraph, corners: str) -> TemporalPlanGraph:
    """Return a graph whose robots pass corners of transits at speed where these are to be smooth."""
    if corners == "rest":
        return tpg
    found = assign_node_times(round_corners(tpg))
    assert any(chain.corners is not None for chain in found.chains)
    return found


def with_heavy_parts(tpg: TemporalPlanGraph, mass: float) -> TemporalPlanGraph:
    objects = tuple(replace(item, mass=mass) for item in tpg.cell.objects)
    return assign_node_times(replace(tpg, cell=replace(tpg.cell, objects=objects)))


def loads(
    recording: Recording, robot: str
) -> Iterator[tuple[float, float, str | None, Transform]]:
    """Yield from when to when a robot holds which object, and how; None for nothing."""
    since, name, pose = 0.0, None, np.eye(4)
    for row in recording.objects:
        if row.holder == robot or row.object == name:
            yield since, row.t, name, pose
            since, pose = row.t, row.pose
            name = row.object if row.holder == robot else None
    yield since, recording.end, name, pose


@CASES
def test_they_keep_within_their_limits(
    corners: str, stalls: Stalls, shipped: ShippedRuns, tmp_path: Path
) -> None:
    found = shipped("multi_arm/tray")
    mass = 1.5
    tpg = with_corners(with_heavy_parts(found.planned.tpg, mass), corners)
    assert slowed_motions(tpg)
    assert not describe_overloaded_joints(tpg)
    recording = recorded(tmp_path, found.scenario, tpg, stalls)
    worst = []
    for robot in tpg.cell.robots:
        rows, drives = recording.robots[robot.name], robot.model.drives
        assert drives is not None
        assert rows.v is not None
        for begin, end, name, pose in loads(recording, robot.name):
            body = PinocchioArm(robot.model).body
            if name is not None:
                size = tpg.cell.object(name).size
                part = pinocchio.Inertia.FromBox(mass, *size)
                place = pinocchio.SE3(robot.model.flange @ pose)
                body.appendBodyToJoint(body.njoints - 1, part, place)
            data = body.createData()
            times = np.arange(begin, end, 0.002)
            for row in zip(*cubic_at(rows.t, rows.q, rows.v, times), strict=True):
                effort = pinocchio.rnea(body, data, *row)
                worst.append(float(np.max(np.abs(effort) / drives.effort)))
    assert max(worst) <= 1.0 + 1e-6
    assert max(worst) > 0.9


def test_what_is_slowed_is_said(shipped: ShippedRuns) -> None:
    tpg = with_heavy_parts(shipped("multi_arm/tray").planned.tpg, 1.5)
    drives = {c.robot: c.drive for c in tpg.chains if c.drive is not None}
    for robot, own in slowed_motions(tpg).items():
        names = tpg.cell.robot(robot).model.joint_names
        by = drives[robot].slowed_by
        for cause, counts in own["by"].items():
            joint = names.index(cause.removeprefix("effort of "))
            nodes = np.flatnonzero(by == BY_EFFORT + joint)
            assert counts["longest"] == drives[robot].slowed[nodes].max()
            assert counts["stretches"] + counts["skills"] <= len(nodes)
            assert counts["label"] == tpg.tasks[counts["task"]].label
    unslowed = [drive.slowed[drive.slowed_by == BY_JOINTS] for drive in drives.values()]
    assert all(np.all(factor == 1.0) for factor in unslowed)


def test_what_no_slowness_bears_is_said(shipped: ShippedRuns) -> None:
    tpg = with_heavy_parts(shipped("multi_arm/tray").planned.tpg, 60.0)
    found = describe_overloaded_joints(tpg)
    assert found
    assert all(
        "gravity alone takes the effort of panda_joint" in words for words in found
    )


FREE, LOADED = 0.3, 0.1
"""Limits of the tool's speed, and of that with a part in hand [m/s]."""


def capped(tpg: TemporalPlanGraph, free: float, loaded: float) -> TemporalPlanGraph:
    robots = []
    for robot in tpg.cell.robots:
        assert robot.limits is not None
        limits = replace(robot.limits, tool_speed=free, loaded_tool_speed=loaded)
        robots.append(replace(robot, limits=limits))
    cell = replace(tpg.cell, robots=tuple(robots))
    return assign_node_times(replace(tpg, cell=cell))


def by_tool_speed(tpg: TemporalPlanGraph) -> int:
    drives = [chain.drive for chain in tpg.chains if chain.drive is not None]
    return sum(int(np.sum(drive.slowed_by == BY_TOOL_SPEED)) for drive in drives)


def in_hand(recording: Recording, robot: str, times: np.ndarray) -> np.ndarray:
    """Return at which times a robot holds a part."""
    held: dict[str, float] = {}
    holds = np.zeros(len(times), dtype=np.bool_)
    for row in recording.objects:
        begin = held.pop(row.object, None)
        if begin is not None:
            holds |= (times > begin) & (times < row.t)
        if row.holder == robot:
            held[row.object] = row.t
    return holds


@CASES
def test_no_executed_motion_passes_them(
    corners: str, stalls: Stalls, shipped: ShippedRuns, tmp_path: Path
) -> None:
    found = shipped("multi_arm/tray")
    tpg = with_corners(capped(found.planned.tpg, FREE, LOADED), corners)
    assert by_tool_speed(tpg) > 10
    assert by_tool_speed(found.planned.tpg) == 0
    recording = recorded(tmp_path, found.scenario, tpg, stalls)
    for robot in tpg.cell.robots:
        rows = recording.robots[robot.name]
        arm = PinocchioArm(robot.model)
        times = np.unique(np.concatenate([rows.t, np.arange(0.0, rows.t[-1], 0.003)]))
        assert rows.v is not None
        q, v, _ = cubic_at(rows.t, rows.q, rows.v, times)
        speeds = arm.tool_speeds(q, v)
        holds = in_hand(recording, robot.name, times)
        assert speeds.max() <= FREE + 1e-6
        assert speeds.max() > 0.8 * FREE
        assert speeds[holds].max() <= LOADED + 1e-6
        assert speeds[holds].max() > 0.8 * LOADED
