"""Robots that touch themselves are found, wherever on their way they do, and no others."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from planning.kinematics.kinematics import frame_pose
from planning.tasks.task import Handling
from planning.transforms import Array, inverse, translation
from scheduling.verification.reference import (
    ReferenceBody,
    ReferenceRobot,
    SeenFrom,
    measure,
)
from scheduling.verification.verify import verify_plan
from tests.scheduling.two_arms import Writer, block, two_arms
from tests.scheduling.verification.test_verification import at, go, graph


def wild_moves(seed: int) -> Writer:
    """Left goes through its joint space, far from everything."""
    writer = Writer(two_arms(gap=20.0))
    rng = np.random.default_rng(seed)
    model = writer.cell.robot("left").model
    for share in rng.uniform(0.02, 0.98, (6, model.dof)):
        goal = model.lower + share * (model.upper - model.lower)
        go(writer, ("left", goal))
    return writer


def least_gap(robot: ReferenceRobot, home: Array, q: Array) -> float:
    """Least distance of parts that do not touch by design."""
    frames = [robot.joint_frames_along(at[None])[0] for at in (home, q)]

    def gap(a: ReferenceBody, b: ReferenceBody, k: int) -> float:
        return measure(a, frames[k][a.joint + 1], b, frames[k][b.joint + 1])

    pairs = [
        (a, b)
        for a, b in combinations(robot.parts, 2)
        if abs(a.joint - b.joint) > 1 and gap(a, b, 0) > 0.0
    ]
    return min(gap(a, b, 1) for a, b in pairs)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_robot_that_touches_itself_is_found(seed: int) -> None:
    writer = wild_moves(seed)
    tpg = graph(writer)
    problems = verify_plan(tpg).problems
    found = {p.first.node for p in problems if p.kind == "itself" and p.first}
    placed = writer.cell.robot("left")
    robot = ReferenceRobot(placed)
    before = placed.home
    touching = set()
    for node, goal in enumerate(tpg.chains[0].waypoints):
        least = min(
            least_gap(robot, placed.home, before + share * (goal - before))
            for share in np.linspace(0.0, 1.0, 12)
        )
        if least < -2e-4:
            touching.add(node)
        before = goal
    assert touching
    assert touching <= found
    assert all(p.distance_m < 0.0 for p in problems if p.kind == "itself")


def test_an_arm_that_touches_what_it_carries_is_found() -> None:
    """A pole in the hand reaches up along the forearm, and then into the upper arm."""
    start = translation(0.30, -0.2, 0.3975)
    pole = block("pole", (0.02, 0.02, 0.30), start)
    writer = Writer(two_arms((pole,), gap=20.0))
    left = writer.cell.robot("left")
    pick = at(writer, "left", 0.30, -0.2, 0.25)
    held = inverse(frame_pose(left, pick)) @ start
    folded = pick.copy()
    folded[4] += 0.8
    go(writer, ("left", pick, Handling("pole", -1, "left", held)), ("left", folded))
    kinds = {
        (p.kind, p.second.body if p.second else None)
        for p in verify_plan(graph(writer)).problems
    }
    assert ("itself", "pole") in kinds


def test_what_a_joint_sees_is_what_moves_after_it() -> None:
    placed = two_arms().robots[0]
    robot = ReferenceRobot(placed)
    path = placed.home + np.linspace(0.0, 0.5, 4)[:, None]
    frames = robot.joint_frames_along(path)
    for joint in range(-1, robot.dof):
        view = SeenFrom(robot, joint)
        seen = view.joint_frames_along(path)
        assert np.allclose(frames[:, joint + 1, None] @ seen, frames)
        assert np.allclose(seen[:, joint + 1], np.eye(4))
        assert np.allclose(view.joint_frame(path[2], 4), seen[2, 5])
        for part in robot.parts:
            moved = view.seen(part).weight
            assert np.all(moved[: joint + 1] == 0.0)
            assert np.array_equal(moved[joint + 1 :], part.weight[joint + 1 :])
