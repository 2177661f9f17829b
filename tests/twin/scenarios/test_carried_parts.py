"""What robots carry keeps the robots' clearance in runs, measured by coal at dense samples."""

import numpy as np
import pytest

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.witness.parts import ConvexPart, measure
from scheduling.witness.robot import WitnessRobot
from tests.shipped_runs import ShippedRuns
from twin.audits.case import tasks_along
from twin.audits.motion.executed import Recording, read_recording

TICK = 0.02
"""Time between two samples [s]."""


def held_parts(
    tpg: TemporalPlanGraph, recording: Recording, robots: dict[str, WitnessRobot]
) -> list[tuple[str, ConvexPart, float, float]]:
    """Who holds what from when until when."""
    out = []
    for name in {row.object for row in recording.objects}:
        rows = [row for row in recording.objects if row.object == name]
        ends = [*(row.t for row in rows[1:]), recording.end]
        for row, end in zip(rows, ends, strict=True):
            if row.holder is not None:
                shape = tpg.cell.object(name).shape
                (part,) = robots[row.holder].loads(name, shape, row.pose)
                out.append((row.holder, part, row.t, end))
    return out


def least_distances(
    tpg: TemporalPlanGraph, recording: Recording
) -> dict[tuple[str, str], tuple[float, float]]:
    """Least distance of a held part from a robot and its load [m], and when [s]."""
    robots = {robot.name: WitnessRobot(robot) for robot in tpg.cell.robots}
    allowed: dict[frozenset[str], list[frozenset[int]]] = {}
    for contact in tpg.allowed:
        pair = frozenset((contact.first, contact.second))
        allowed.setdefault(pair, []).append(contact.tasks)
    held = held_parts(tpg, recording, robots)
    found: dict[tuple[str, str], tuple[float, float]] = {}
    for holder, part, start, end in held:
        times = np.arange(start, end, TICK)
        frames = {
            name: robot.joint_frames_along(recording.robots[name].at(times))
            for name, robot in robots.items()
        }
        hand = frames[holder][:, part.joint + 1]
        centre = hand[:, :3, :3] @ part.centre + hand[:, :3, 3]
        doing = {n: tasks_along(tpg, recording.robots, n, times) for n in robots}
        for name in robots.keys() - {holder}:
            loads = [
                p for who, p, a, b in held if who == name and a < end and start < b
            ]
            spans = {p.entity: (a, b) for who, p, a, b in held if who == name}
            for other in (*robots[name].parts, *loads):
                there = frames[name][:, other.joint + 1]
                apart = there[:, :3, :3] @ other.centre + there[:, :3, 3] - centre
                near = (
                    np.linalg.norm(apart, axis=1) < part.radius + other.radius + 0.002
                )
                for k in np.flatnonzero(near).tolist():
                    t = float(times[k])
                    since, until = spans.get(other.entity, (0.0, recording.end))
                    if other.entity == part.entity or not since <= t < until:
                        continue
                    if any(
                        tasks & doing[holder][k] and tasks & doing[name][k]
                        for tasks in allowed.get(
                            frozenset((part.entity, other.entity)), ()
                        )
                    ):
                        continue
                    gap = measure(part, hand[k], other, there[k])
                    key = part.entity, other.entity
                    if gap < found.get(key, (np.inf, 0.0))[0]:
                        found[key] = gap, t
    return found


@pytest.mark.parametrize(
    ("name", "nearest"),
    [
        ("lego/cliff", 0.005),
        ("multi_arm/rearrangement", 0.015),
        pytest.param("multi_arm/assembly", 0.002, marks=pytest.mark.nightly),
    ],
)
def test_carried_parts_keep_the_clearance_of_robots(
    shipped: ShippedRuns, name: str, nearest: float
) -> None:
    run = shipped(name)
    tpg = run.planned.tpg
    recording = read_recording(run.trial.files, tpg.cell)
    found = least_distances(tpg, recording)
    clearance = tpg.cell.clearances.robot_robot
    too_near = {key: at for key, at in found.items() if at[0] < clearance - 2e-5}
    assert too_near == {}
    assert min(gap for gap, _ in found.values()) < nearest  # they do come near


def test_the_measurement_sees_what_comes_too_near(shipped: ShippedRuns) -> None:
    """With one robot's motion half a second late, something does."""
    from dataclasses import replace

    run = shipped("lego/cliff")
    tpg = run.planned.tpg
    recording = read_recording(run.trial.files, tpg.cell)
    left = recording.robots["left"]
    late = replace(left, t=left.t + 20.0)
    moved = replace(recording, robots={**recording.robots, "left": late})
    found = least_distances(tpg, moved)
    assert min(gap for gap, _ in found.values()) < tpg.cell.clearances.robot_robot
