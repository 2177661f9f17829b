"""Forward kinematics against pinocchio, inverse kinematics against forward kinematics."""

from functools import cache
from typing import Any

import numpy as np
import pinocchio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.caches import BoundedCache
from planning.cell.robot_model import KinematicChain, RobotModel
from planning.cell.workcell import PlacedRobot
from planning.errors import RobotModelError
from planning.kinematics import kinematics
from planning.kinematics.damped_least_squares import TOLERANCE
from planning.kinematics.kinematics import (
    follow_poses,
    frame_pose,
    inverse_kinematics,
)
from planning.robots.registry import ROBOTS, robot_model
from planning.transforms import (
    Array,
    Transform,
    from_rpy,
    identity,
    read_only_copy,
    rotation,
    translation,
)

BASE = from_rpy((0.4, -0.2, 0.9), (0.1, -0.2, 2.5))


def placed(model: RobotModel, base: Transform = BASE) -> PlacedRobot:
    return PlacedRobot("arm", model, base, model.home)


@cache
def pinocchio_model(name: str) -> Any:
    model = robot_model(name)
    full = pinocchio.buildModelFromUrdf(str(model.urdf))
    still = pinocchio.neutral(full)
    for joint, value in ROBOTS[name].frozen.items():
        still[full.joints[full.getJointId(joint)].idx_q] = value
    ids = [full.getJointId(joint) for joint in ROBOTS[name].frozen]
    return pinocchio.buildReducedModel(full, ids, still) if ids else full


def pose_error(pose: Transform, target: Transform) -> tuple[float, float]:
    turn = pose[:3, :3].T @ target[:3, :3]
    sine = np.linalg.norm(turn - turn.T) / np.sqrt(8.0)
    angle = np.arctan2(sine, (np.trace(turn) - 1.0) / 2.0)
    return float(np.linalg.norm(pose[:3, 3] - target[:3, 3])), float(angle)


def gp4_by_table(q: Array, d6: float = -0.072, a6: float = 0.0) -> Transform:
    """Denavit-Hartenberg product of the GP4: rows of theta offset, d, a, alpha."""
    half = np.pi / 2
    rows = [
        (0.0, 0.0, 0.0, -half),
        (-half, 0.0, 0.26, np.pi),
        (0.0, 0.0, 0.015, -half),
        (0.0, -0.29, 0.0, half),
        (0.0, 0.0, 0.0, -half),
        (0.0, d6, a6, np.pi),
    ]
    pose = translation(0.0, 0.0, 0.33)
    for value, (offset, d, a, alpha) in zip(q, rows, strict=True):
        pose = pose @ rotation("z", value + offset) @ translation(a, 0.0, d)
        pose = pose @ rotation("x", alpha)
    return pose


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_flange_pose_agrees_with_pinocchio(name: str) -> None:
    model, reference = robot_model(name), pinocchio_model(name)
    data = reference.createData()
    link = reference.getFrameId(ROBOTS[name].flange_link, pinocchio.FrameType.BODY)
    rng = np.random.default_rng(1)
    for q in rng.uniform(model.lower, model.upper, (50, model.dof)):
        pinocchio.framesForwardKinematics(reference, data, q)
        expected = BASE @ data.oMf[link].homogeneous @ ROBOTS[name].flange_offset
        assert np.allclose(frame_pose(placed(model), q), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("frame", "d6", "a6"),
    [
        ("flange", -0.072, 0.0),
        ("tool", -0.183, 0.0),
        ("assemble", -0.1825, 0.0078),
        ("disassemble", -0.192, 0.0),
        ("alt", -0.1784, -0.0174),
        ("alt_assemble", -0.1784, -0.0078),
        ("handover_assemble", -0.1815, 0.0078),
    ],
)
def test_gp4_frames_are_those_of_its_table(frame: str, d6: float, a6: float) -> None:
    model = robot_model("gp4")
    robot = placed(model, identity())
    rng = np.random.default_rng(2)
    for q in rng.uniform(model.lower, model.upper, (30, 6)):
        expected = gp4_by_table(q, d6, a6)
        assert np.allclose(frame_pose(robot, q, frame), expected, atol=1e-12)


def test_gp4_home_points_down_in_front_of_the_arm() -> None:
    model = robot_model("gp4")
    flange = frame_pose(placed(model, identity()), model.home)
    assert np.allclose(flange[:3, 3], (0.2, 0.0, 0.4), atol=1e-4)
    assert np.allclose(flange[:3, 2], (0.0, 0.0, -1.0), atol=1e-5)


@settings(max_examples=150, deadline=None)
@given(
    name=st.sampled_from(sorted(ROBOTS)),
    share=st.lists(st.floats(0.02, 0.98), min_size=10, max_size=10),
)
def test_reachable_targets_are_reached(name: str, share: list[float]) -> None:
    model = robot_model(name)
    robot = placed(model)
    q = model.lower + np.array(share[: model.dof]) * (model.upper - model.lower)
    target = frame_pose(robot, q, "tool")
    solutions = inverse_kinematics(robot, "tool", target, model.home, restarts=100)
    assert solutions
    nearness = [np.abs(x - model.home).sum() for x in solutions]
    assert nearness == sorted(nearness)
    for x in solutions:
        assert np.all(x >= model.lower)
        assert np.all(x <= model.upper)
        distance, angle = pose_error(frame_pose(robot, x, "tool"), target)
        assert distance < 1.01 * TOLERANCE
        assert angle < 1.01 * TOLERANCE
    for k, x in enumerate(solutions):
        assert all(np.abs(x - y).max() > 1e-4 for y in solutions[:k])


def gp4_in_closed_form(target: Transform) -> list[Array]:
    """All configurations (each joint in -pi..pi) that bring the GP4's flange to a target.

    Two shoulders, two elbows, two wrists: the three wrist axes meet in one point.
    """
    upper_arm, forearm = 0.26, np.hypot(0.29, 0.015)
    out = []
    x, y, z = target[:3, 3] - 0.072 * target[:3, 2] - (0.0, 0.0, 0.33)
    for side in (1.0, -1.0):
        q1 = np.arctan2(side * y, side * x)
        r = side * np.hypot(x, y)
        cosine = (r * r + z * z - upper_arm**2 - forearm**2) / (2 * upper_arm * forearm)
        if abs(cosine) > 1.0:
            continue
        for bend in (np.arccos(cosine), -np.arccos(cosine)):
            q2 = np.arctan2(r, z) - np.arctan2(
                forearm * np.sin(bend), upper_arm + forearm * np.cos(bend)
            )
            pitch = q2 + bend - np.pi / 2 + np.arctan2(0.015, 0.29)
            arm = rotation("z", q1) @ rotation("y", pitch)
            mount = from_rpy((0.0, 0.0, 0.0), (np.pi, -np.pi / 2, 0.0))
            wrist = arm[:3, :3].T @ target[:3, :3] @ mount[:3, :3].T
            for flip in (1.0, -1.0):
                q5 = -flip * np.arccos(np.clip(wrist[0, 0], -1.0, 1.0))
                q4 = -np.arctan2(flip * wrist[1, 0], -flip * wrist[2, 0])
                q6 = -np.arctan2(flip * wrist[0, 1], flip * wrist[0, 2])
                q = np.array([q1, q2, q2 - pitch, q4, q5, q6])
                out.append((q + np.pi) % (2 * np.pi) - np.pi)
    return out


def test_all_branches_of_the_gp4_are_found() -> None:
    """Against the closed form: the same set of configurations, none missing, none extra."""
    model = robot_model("gp4")
    robot = placed(model, identity())
    rng = np.random.default_rng(8)
    counts = []
    for _ in range(25):
        q = rng.uniform(model.lower, model.upper)
        if abs(np.sin(q[4])) < 0.1:
            continue  # near the wrist singularity branches come arbitrarily close
        target = frame_pose(robot, q)
        expected = []
        for x in gp4_in_closed_form(target):
            assert np.allclose(frame_pose(robot, x), target, atol=1e-9)
            turns = np.ceil((model.lower - x) / (2 * np.pi)) * 2 * np.pi
            if np.all(x + turns <= model.upper):
                expected.append(x)
        found = inverse_kinematics(robot, "flange", target, model.home, restarts=400)
        gaps = np.array(
            [
                [np.abs(np.exp(1j * x) - np.exp(1j * y)).max() for y in found]
                for x in expected
            ]
        )
        assert len(found) == len(expected)
        assert gaps.min(axis=1).max() < 1e-5
        assert gaps.min(axis=0).max() < 1e-5
        counts.append(len(found))
    assert max(counts) == 8


def test_seed_that_solves_is_returned_first() -> None:
    model = robot_model("panda")
    robot = placed(model)
    target = frame_pose(robot, model.home, "tool")
    first = inverse_kinematics(robot, "tool", target, model.home)[0]
    assert np.allclose(first, model.home, atol=1e-9)


def test_whole_turns_follow_the_seed() -> None:
    """J6 of the GP4 has 900 degrees: of the equivalent values the seed's turn is taken."""
    model = robot_model("gp4")
    robot = placed(model)
    q = model.home.copy()
    q[5] = np.radians(40.0)
    target = frame_pose(robot, q, "tool")
    for turn in (-360.0, 0.0, 360.0):
        seed = q.copy()
        seed[5] += np.radians(turn)
        first = inverse_kinematics(robot, "tool", target, seed)[0]
        assert np.allclose(first, seed, atol=1e-6)
    beyond = q.copy()
    beyond[5] = np.radians(440.0)  # 40 + 2 * 200: nearest within 450 is 400
    first = inverse_kinematics(robot, "tool", target, beyond)[0]
    assert first[5] == pytest.approx(np.radians(400.0), abs=1e-6)


def test_out_of_reach_gives_no_solution() -> None:
    model = robot_model("gp4")
    target = BASE @ translation(1.5, 0.0, 0.5)
    assert inverse_kinematics(placed(model), "tool", target, model.home) == []


def test_the_same_question_has_the_same_answer_and_no_one_can_change_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot = placed(robot_model("iiwa14"))
    target = frame_pose(robot, robot.home, "tool") @ translation(0.05, 0.02, -0.1)
    first = inverse_kinematics(robot, "tool", target, robot.home)
    assert len(first) > 5
    kept = [solution.copy() for solution in first]
    for solution in first:
        solution[:] = 7.0
    assert np.array_equal(inverse_kinematics(robot, "tool", target, robot.home), kept)
    # Worked out anew, not remembered.
    monkeypatch.setattr(kinematics, "_SOLVED", BoundedCache(10))
    assert np.array_equal(inverse_kinematics(robot, "tool", target, robot.home), kept)


def test_sliding_joints_are_solved_too() -> None:
    """A gantry: three slides and a wrist, solved in closed form by hand."""
    gp4 = robot_model("gp4")
    placement = np.tile(np.eye(4), (6, 1, 1))
    placement[:, :3, :3] = np.eye(3)
    chain = KinematicChain(
        read_only_copy(placement),
        read_only_copy(np.vstack([np.eye(3), [[0, 0, 1], [0, 1, 0], [1, 0, 0]]])),
        np.array([True, True, True, False, False, False]),
    )
    model = RobotModel(
        name="gantry",
        urdf=gp4.urdf,
        package_dirs=(),
        joint_names=("x", "y", "z", "yaw", "pitch", "roll"),
        lower=read_only_copy([-1.0, -1.0, -1.0, -3.0, -1.5, -3.0]),
        upper=read_only_copy([1.0, 1.0, 1.0, 3.0, 1.5, 3.0]),
        velocity=read_only_copy(np.ones(6)),
        chain=chain,
        flange=read_only_copy(np.eye(4)),
        frames={},
        parts=(),
        never_collide=frozenset(),
        home=read_only_copy(np.zeros(6)),
    )
    q = np.array([0.5, -0.7, 0.2, 1.1, -0.6, 0.4])
    target = from_rpy((0.5, -0.7, 0.2), (0.4, -0.6, 1.1))
    robot = placed(model, identity())
    assert np.allclose(frame_pose(robot, q), target)
    solutions = inverse_kinematics(robot, "flange", target, model.home)
    assert np.allclose(solutions[0], q, atol=1e-6)


def test_unknown_frame_lists_the_frames() -> None:
    robot = placed(robot_model("panda"))
    with pytest.raises(RobotModelError, match="'gripper'") as caught:
        frame_pose(robot, robot.home, "gripper")
    assert caught.value.choices == ("flange", "tool", "tip")


@settings(max_examples=60, deadline=None)
@given(
    name=st.sampled_from(sorted(ROBOTS)),
    share=st.lists(st.floats(0.1, 0.9), min_size=10, max_size=10),
    steps=st.lists(
        st.lists(st.floats(-0.4, 0.4), min_size=10, max_size=10), min_size=1, max_size=5
    ),
    far=st.booleans(),
)
def test_following_poses_is_solving_for_one_after_another(
    name: str, share: list[float], steps: list[list[float]], far: bool
) -> None:
    """Also where the way leads out of reach, and back."""
    model = robot_model(name)
    robot = placed(model)
    q = model.lower + np.array(share[: model.dof]) * (model.upper - model.lower)
    start, targets = q, [frame_pose(robot, q, "tool")]
    for step in steps:
        q = np.clip(q + np.array(step[: model.dof]), model.lower, model.upper)
        targets.append(frame_pose(robot, q, "tool"))
    if far:
        targets[len(targets) // 2] = translation(9.0, 0.0, 0.0)
    found = list(follow_poses(robot, ["tool"] * len(targets), targets, start))
    last = start
    for target, solution in zip(targets[1:], found, strict=False):
        by_one = inverse_kinematics(robot, "tool", target, last, restarts=0)
        by_one = by_one or inverse_kinematics(robot, "tool", target, last, restarts=20)
        if not by_one:
            assert solution is None
            break
        assert solution is not None
        assert np.allclose(solution, by_one[0], atol=1e-6)
        last = solution
    assert (found[-1] is None) is (len(found) < len(targets) - 1 or not by_one)
