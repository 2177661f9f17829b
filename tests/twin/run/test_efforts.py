"""Efforts of joints in executed runs, worked out by pinocchio of the tables that a run leaves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from planning.transforms import Transform
from scheduling.graph.drive import BY_EFFORT, BY_JOINTS
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.motion_times import within_limits
from scheduling.pace import overloads, slowed_motions
from tests.planning.timing.pinocchio_arm import PinocchioArm
from tests.shipped_runs import ShippedRuns
from tests.twin.run.recordings import (
    MANY_STALLS,
    NO_STALLS,
    recorded,
    with_rounded_corners,
)
from twin.audit.motion.executed import Recording
from twin.run.driven_motion import cubic_at
from twin.uncertainty.disturbances import Stalls


def with_heavy_parts(tpg: TemporalPlanGraph, mass: float) -> TemporalPlanGraph:
    objects = tuple(replace(item, mass=mass) for item in tpg.cell.objects)
    return within_limits(replace(tpg, cell=replace(tpg.cell, objects=objects)))


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


@pytest.mark.parametrize("corners", ["rest", "smooth"])
@pytest.mark.parametrize("stalls", [NO_STALLS, MANY_STALLS], ids=["calm", "late"])
def test_they_keep_within_their_limits(
    corners: str, stalls: Stalls, shipped: ShippedRuns, tmp_path: Path
) -> None:
    found = shipped("multi_arm/tray")
    mass = 1.5
    tpg = with_heavy_parts(found.planned.tpg, mass)
    if corners == "smooth":
        tpg = with_rounded_corners(tpg)
    assert slowed_motions(tpg)
    assert not overloads(tpg)
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
    found = overloads(tpg)
    assert found
    assert all(
        "gravity alone takes the effort of panda_joint" in words for words in found
    )
