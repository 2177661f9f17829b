"""Limits of the tool's speed, measured by pinocchio in the tables that a run leaves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scheduling.graph.drive import BY_TOOL_SPEED
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.motion_times import within_limits
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

FREE, LOADED = 0.3, 0.1
"""Limits of the tool's speed, and of that with a part in hand [m/s]."""


def capped(tpg: TemporalPlanGraph, free: float, loaded: float) -> TemporalPlanGraph:
    robots = []
    for robot in tpg.cell.robots:
        assert robot.limits is not None
        limits = replace(robot.limits, tool_speed=free, loaded_tool_speed=loaded)
        robots.append(replace(robot, limits=limits))
    cell = replace(tpg.cell, robots=tuple(robots))
    return within_limits(replace(tpg, cell=cell))


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


@pytest.mark.parametrize("corners", ["rest", "smooth"])
@pytest.mark.parametrize("stalls", [NO_STALLS, MANY_STALLS], ids=["calm", "late"])
def test_no_executed_motion_passes_them(
    corners: str, stalls: Stalls, shipped: ShippedRuns, tmp_path: Path
) -> None:
    found = shipped("multi_arm/tray")
    tpg = capped(found.planned.tpg, FREE, LOADED)
    if corners == "smooth":
        tpg = with_rounded_corners(tpg)
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
