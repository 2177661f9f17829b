"""Robots that touch themselves or what they carry, or come near to what others carry, are found."""

from itertools import combinations

import numpy as np
import pytest

from planning.cell.workcell import Attachment, WorldState
from planning.errors import PlanInvariantError
from planning.geometry.moving_pairs import MovingPair
from planning.geometry.scene_checker import SceneChecker
from planning.kinematics.kinematics import frame_pose
from planning.tasks.task import AllowedContact, Handling
from planning.transforms import Array, inverse, translation
from scheduling.build_tpg import build_tpg
from scheduling.verification.reference import (
    ReferenceBody,
    ReferenceRobot,
    SeenFrom,
    measure,
)
from scheduling.verification.verify import verify_plan
from tests.scheduling.two_arms import Writer, block, two_arms
from tests.scheduling.verification.test_verification import at, go, graph, named


def beside_a_beam(gap: float, *, leaves: bool) -> Writer:
    """Left holds a beam; right comes down on its end, but for a gap, and maybe goes home."""
    at_stock = translation(0.44, -0.2, 0.2375)
    writer = Writer(two_arms((block("beam", (0.34, 0.03, 0.02), at_stock),)))
    left, right = writer.cell.robots
    pick, hold = (at(writer, "left", 0.29, y, 0.25) for y in (-0.2, 0.0))
    local = inverse(frame_pose(left, pick)) @ at_stock
    go(writer, ("left", pick, Handling("beam", -1, "left", local)), ("left", hold))
    goal, height = right.home, 0.30
    for _ in range(4):
        goal = at(writer, "right", 0.59, 0.0, height)
        height += gap - distance(writer, hold, local, goal)
    assert distance(writer, hold, local, goal) == pytest.approx(gap, abs=1e-5)
    go(writer, ("right", goal), *([("right", None)] if leaves else []))
    everything = frozenset(task.index for task in writer.tasks)
    writer.allowed.append(AllowedContact("left/tool", "beam", everything))
    return writer


def distance(writer: Writer, hold: Array, local: Array, goal: Array) -> float:
    """How far the beam is from the right robot."""
    left, right = (ReferenceRobot(robot) for robot in writer.cell.robots)
    (beam,) = left.loads("beam", writer.cell.object("beam").shape, local)
    hand = left.joint_frame(hold, beam.joint)
    return min(
        measure(beam, hand, part, right.joint_frame(goal, part.joint))
        for part in right.parts
    )


@pytest.mark.parametrize("gap", [0.0003, 0.0007])
def test_a_robot_too_near_to_a_part_that_another_holds_is_found(gap: float) -> None:
    writer = beside_a_beam(gap, leaves=True)
    report = verify_plan(graph(writer, (0, 1, 1, 0)))
    assert {named(p)[0] for p in report.problems} == {"hold"}
    assert all("beam" in p.message for p in report.problems)
    with pytest.raises(PlanInvariantError, match="stands after node 1 of robot 'left'"):
        build_tpg(writer.plan())


def test_a_robot_that_keeps_the_clearance_from_it_may_pass() -> None:
    writer = beside_a_beam(0.0013, leaves=True)
    tpg = build_tpg(writer.plan())
    assert verify_plan(tpg).ok
    # And without the edges left swings the beam through where right may be already.
    assert "nodes" in {named(p)[0] for p in verify_plan(graph(writer)).problems}


@pytest.mark.parametrize(("gap", "free"), [(0.0007, False), (0.0013, True)])
def test_motions_past_a_part_in_another_hand_keep_it_too(
    gap: float, free: bool
) -> None:
    writer = beside_a_beam(gap, leaves=False)
    held = writer.tasks[0].handlings[0]
    state = WorldState(writer.q, {"beam": Attachment("left", held.pose)})
    grips = frozenset({frozenset(("left/tool", "beam"))})
    for robot in ("left", "right"):
        checker = SceneChecker(writer.cell, robot, state, grips)
        assert checker.configuration_free(writer.q[robot]) is free
    pair = MovingPair(writer.cell, "left", "right", state, grips)
    assert pair.clear(writer.q["left"], writer.q["right"]) is free


def test_a_part_at_rest_is_not_touched_but_may_be_as_near_as_one_likes() -> None:
    writer = beside_a_beam(0.0003, leaves=False)
    left = writer.cell.robot("left")
    held = writer.tasks[0].handlings[0]
    lies = frame_pose(left, writer.q["left"]) @ held.pose
    state = WorldState(
        {"left": left.home, "right": writer.q["right"]},
        {"beam": Attachment(None, lies)},
    )
    checker = SceneChecker(writer.cell, "right", state)
    assert checker.configuration_free(np.array(writer.q["right"]))


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
