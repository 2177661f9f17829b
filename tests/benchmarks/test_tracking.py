"""Following exported trajectories: what is read from the file, the plant, and the controllers."""

import json
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from benchmarks.tracking.exported_motion import Reference, read_exported_motion
from planning.cell.workcell import PlacedRobot, Workcell
from planning.robots.registry import robot_model
from twin.audit.worlds.engines import open_world

pytest.importorskip("pybullet")
pinocchio = pytest.importorskip("pinocchio")

from benchmarks.tracking.controller import (  # noqa: E402
    ComputedTorque,
    JointByJoint,
)
from benchmarks.tracking.described_robot import (  # noqa: E402
    PLACE,
    DescribedRobot,
    Payload,
    described_robot,
)
from benchmarks.tracking.exported_motion import (  # noqa: E402
    ExportedMotion,
    Handling,
)
from benchmarks.tracking.following import (  # noqa: E402
    RobotDistances,
    follow,
)
from benchmarks.tracking.plant import STEP_S, Flaws, Plant  # noqa: E402

GRAVITY = 9.81
ROD_KG, ROD_M = 3.0, 0.8
LOAD = Payload(place=0, mass=2.0, inertia=(0.01, 0.02, 0.03))

ARM = f"""<robot name="two">
  <link name="foot"/>
  <link name="upper"><inertial><origin xyz="0 0 {ROD_M / 2}"/><mass value="{ROD_KG}"/>
    <inertia ixx="0.16" iyy="0.17" izz="0.03" ixy="0.01" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 {ROD_M / 2}"/>
    <geometry><box size="0.1 0.1 {ROD_M}"/></geometry></collision></link>
  <link name="lower"><inertial><origin xyz="0 0.1 0.2" rpy="0.3 0.1 0"/><mass value="1.5"/>
    <inertia ixx="0.03" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="{PLACE}0"><inertial><mass value="0"/>
    <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="foot"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-9" upper="9" effort="200" velocity="9"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz="0 0 {ROD_M}" rpy="0.4 0 0"/><axis xyz="1 0 0"/>
    <limit lower="-9" upper="9" effort="90" velocity="9"/></joint>
  <joint name="{PLACE}0" type="fixed"><parent link="lower"/><child link="{PLACE}0"/>
    <origin xyz="0.05 0 0.4" rpy="0.1 0.2 0.3"/></joint>
</robot>"""


def _arm(name: str = "arm", x_m: float = 0.0) -> DescribedRobot:
    """Return an arm of two joints on an upright base that is turned by 0.7 rad."""
    base = np.eye(4)
    base[:2, :2] = [[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]]
    base[0, 3] = x_m
    joints = ("shoulder", "elbow")
    holds = {"brick": (LOAD,)}
    return DescribedRobot(name, ARM, joints, (200.0, 90.0), (False, False), base, holds)


def _model(loaded: bool) -> pinocchio.Model:
    """Return the same arm in pinocchio, with a part in hand or without."""
    model = pinocchio.buildModelFromXML(ARM)
    if loaded:
        frame = model.frames[model.getFrameId(f"{PLACE}0", pinocchio.FrameType.BODY)]
        part = pinocchio.Inertia(LOAD.mass, np.zeros(3), np.diag(LOAD.inertia))
        joint = frame.parentJoint
        model.inertias[joint] = model.inertias[joint] + frame.placement.act(part)
    return model


def _states(count: int) -> list[np.ndarray]:
    return list(np.random.default_rng(5).uniform(-1.5, 1.5, (count, 3, 2)))


def _point(t_ns: int, q: list[float], rest: list[list[float]]) -> dict[str, object]:
    return {
        "positions": q,
        "velocities": rest[0] if rest else [],
        "accelerations": rest[1] if rest else [],
        "time_from_start": {"sec": t_ns // 10**9, "nanosec": t_ns % 10**9},
    }


def _segment(number: int, span: list[float], points: list[object]) -> dict[str, object]:
    return {
        "id": f"left/{number}",
        "robot": "left",
        "nominal_s": span,
        "motion_s": span,
        "handlings": [],
        "joint_trajectory": {"joint_names": ["a"], "points": points},
    }


def _file(folder: Path, segments: list[dict[str, object]]) -> Path:
    path = folder / "motions.json"
    path.write_text(json.dumps({"segments": segments}), encoding="utf-8")
    return path


@given(st.lists(st.floats(-2, 2), min_size=6, max_size=6), st.integers(2, 9))
@settings(max_examples=50, deadline=None)
def test_polynomials_of_degree_five_are_met_between_points(
    coefficients: list[float], points: int
) -> None:
    motion = Polynomial(coefficients)
    knots = np.sort(np.random.default_rng(points).uniform(0, 2, points))
    q, v, a = (motion.deriv(k)(knots)[:, None] for k in range(3))
    times = np.linspace(knots[0], knots[-1], 101)
    found = Reference(("a",), knots, q, v, a).states_at(times)
    for k, states in enumerate(found):
        np.testing.assert_allclose(states[:, 0], motion.deriv(k)(times), atol=1e-6)


def test_positions_alone_are_joined_by_straight_lines() -> None:
    reference = Reference(
        ("a",), np.array([0.0, 1.0, 3.0]), np.array([[0.0], [2.0], [1.0]]), None, None
    )
    q, v, a = reference.states_at(np.array([-1.0, 0.5, 1.5, 2.0, 9.0]))
    np.testing.assert_allclose(q[:, 0], [0.0, 1.0, 1.75, 1.5, 1.0])
    np.testing.assert_allclose(v[:, 0], [0.0, 2.0, -0.5, -0.5, 0.0])
    assert not a.any()


def test_segments_follow_each_other_and_rest_in_between(tmp_path: Path) -> None:
    still = [[0.0], [0.0]]
    path = _file(
        tmp_path,
        [
            _segment(
                0, [1.0, 2.0], [_point(0, [0.0], still), _point(10**9, [1.0], still)]
            ),
            _segment(
                1, [4.0, 5.0], [_point(0, [1.0], still), _point(10**9, [3.0], still)]
            ),
        ],
    )
    motion = read_exported_motion(path)
    assert motion.within_limits
    assert motion.end_s == 5.0
    q, v, _ = motion.robots["left"].states_at(np.array([0.5, 1.5, 3.0, 4.5, 6.0]))
    np.testing.assert_allclose(q[:, 0], [0.0, 0.5, 1.0, 2.0, 3.0])
    np.testing.assert_allclose(v[[0, 2, 4], 0], 0.0)


def test_a_robot_that_would_jump_is_refused(tmp_path: Path) -> None:
    ends = [_point(0, [0.0], []), _point(10**9, [1.0], [])]
    path = _file(
        tmp_path, [_segment(0, [0.0, 1.0], ends), _segment(1, [1.0, 2.0], ends)]
    )
    with pytest.raises(ValueError, match=r"left/1 at 1\.0+ s: positions jump by 1"):
        read_exported_motion(path)


def test_a_segment_that_was_not_executed_is_refused(tmp_path: Path) -> None:
    still = [[0.0], [0.0]]
    segment = _segment(0, [0.0, 1.0], [_point(0, [0.0], still)])
    with pytest.raises(ValueError, match="left/0 was not executed"):
        read_exported_motion(_file(tmp_path, [segment | {"motion_s": None}]))


@pytest.mark.parametrize("loaded", [False, True])
def test_the_plant_accelerates_as_pinocchio_says(loaded: bool) -> None:
    model = _model(loaded)
    data = model.createData()
    with closing(Plant([_arm()])) as plant:
        if loaded:
            plant.carry(0, LOAD, True)
        for q, v, torque in _states(20):
            plant.put(0, q, v)
            plant.advance([20.0 * torque], 1)
            expected = pinocchio.aba(model, data, q, v, 20.0 * torque)
            found = (plant.state(0)[1] - v) / STEP_S
            np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_shipped_robots_accelerate_as_pinocchio_says(name: str) -> None:
    placed = PlacedRobot(name, robot_model(name), np.eye(4), robot_model(name).home)
    robot = described_robot(placed, {}, [])
    model = pinocchio.buildModelFromXML(robot.urdf)
    data = model.createData()
    n = len(robot.joints)
    with closing(Plant([robot])) as plant:
        for row in np.random.default_rng(2).uniform(-1, 1, (5, 3, n)):
            q, v = placed.home + 0.3 * row[0], row[1]
            torque = pinocchio.rnea(model, data, q, v, 3 * row[2])
            plant.put(0, q, v)
            plant.advance([torque], 1)
            found = (plant.state(0)[1] - v) / STEP_S
            np.testing.assert_allclose(found, 3 * row[2], rtol=1e-6, atol=1e-6)


def test_a_part_put_down_weighs_nothing_any_more() -> None:
    with closing(Plant([_arm()])) as plant, closing(Plant([_arm()])) as other:
        plant.carry(0, LOAD, True)
        plant.carry(0, LOAD, False)
        for each in (plant, other):
            each.put(0, np.array([0.5, 0.5]), np.zeros(2))
            each.advance([np.zeros(2)], 100)
        np.testing.assert_array_equal(plant.state(0), other.state(0))


def test_heavier_links_accelerate_as_if_torques_were_less() -> None:
    q, v, torque = _states(1)[0]
    speeds = []
    for heavier, share in ((0.25, 1.0), (0.0, 1.0 / 1.25)):
        with closing(Plant([_arm()], Flaws(heavier=heavier))) as plant:
            plant.put(0, q, v)
            plant.advance([50.0 * share * torque], 1)
            speeds.append(plant.state(0)[1])
    np.testing.assert_allclose(speeds[0], speeds[1], rtol=1e-9)


def test_dry_friction_holds_and_brakes() -> None:

    model = _model(False)
    data = model.createData()
    q = np.array([0.2, 0.1])
    weight = pinocchio.rnea(model, data, q, np.zeros(2), np.zeros(2))
    friction = (np.abs(weight) * 1.5,)
    with closing(Plant([_arm()], Flaws(friction=friction))) as plant:
        plant.put(0, q, np.zeros(2))
        plant.advance([np.zeros(2)], 200)
        np.testing.assert_allclose(plant.state(0)[0], q, atol=1e-4)
    with closing(Plant([_arm()], Flaws(friction=(friction[0] / 3,)))) as plant:
        plant.put(0, q, np.zeros(2))
        plant.advance([np.zeros(2)], 200)
        assert np.max(np.abs(plant.state(0)[0] - q)) > 1e-3


@pytest.mark.parametrize("loaded", [False, True])
def test_controllers_know_the_inverse_dynamics(loaded: bool) -> None:
    model = _model(loaded)
    data = model.createData()
    with closing(ComputedTorque(_arm())) as controller:
        controller.hold(frozenset())
        for payloads in (
            (frozenset({LOAD}), frozenset()) if not loaded else (frozenset({LOAD}),)
        ):
            controller.hold(payloads)
        for q, v, a in _states(20):
            expected = pinocchio.rnea(model, data, q, v, a)
            np.testing.assert_allclose(
                controller.inverse_dynamics(q, v, a), expected, atol=1e-9
            )
            torque, wanted = controller.torque((q, v, a), (q, v))
            np.testing.assert_allclose(wanted, expected, atol=1e-9)
            np.testing.assert_allclose(torque, np.clip(expected, -200, 200), atol=1e-9)


def test_a_joint_on_its_own_knows_its_inertia_and_gravity_at_the_start() -> None:
    model = _model(False)
    data = model.createData()
    q, v, a = _states(1)[0]
    with closing(JointByJoint(_arm())) as controller:
        _, wanted = controller.torque((q, v, a), (q, v))
    gravity = pinocchio.rnea(model, data, q, np.zeros(2), np.zeros(2))
    inertia = np.diag(pinocchio.crba(model, data, q))
    np.testing.assert_allclose(wanted, gravity + inertia * a, atol=1e-9)


def test_torques_stay_within_effort_limits() -> None:
    weak = replace(_arm(), effort=(5.0, 1.0))
    with closing(ComputedTorque(weak)) as controller:
        q, v, a = np.array([1.0, 1.0]), np.zeros(2), np.array([90.0, -90.0])
        torque, wanted = controller.torque((q, v, a), (q, v))
    assert np.all(np.abs(wanted) > [5.0, 1.0])
    np.testing.assert_allclose(torque, np.sign(wanted) * [5.0, 1.0])


def test_tilted_bases_are_refused() -> None:
    tilted = replace(_arm(), base=np.diag([1.0, -1.0, -1.0, 1.0]))
    with pytest.raises(ValueError, match="arm: the base is tilted"):
        ComputedTorque(tilted)


def _swing(within_limits: bool, seconds: float = 1.0) -> ExportedMotion:
    """Return a motion of 1 rad: smooth, or at full speed at once; a part is picked midway."""
    time_s = np.array([0.0, seconds])
    q = np.array([[0.2, -0.3], [1.2, 0.7]])
    still = np.zeros((2, 2)) if within_limits else None
    reference = Reference(("shoulder", "elbow"), time_s, q, still, still)
    handlings = (Handling(0.5 * seconds, "brick", "arm"),)
    return ExportedMotion({"arm": reference}, handlings, within_limits, seconds)


def test_smooth_motions_are_followed_closely_and_jumps_are_not() -> None:
    (smooth,) = follow([_arm()], _swing(True))
    (jump,) = follow([_arm()], _swing(False))
    assert len(smooth.error) == 1000
    assert np.max(smooth.error) < 1e-4
    assert np.max(jump.error) > 1e-3
    # A part that the controller does not expect so heavy, and friction, are seen.
    (flawed,) = follow([_arm()], _swing(True), Flaws(0.1, (np.array([1.0, 1.0]),)))
    assert np.max(smooth.error) < np.max(flawed.error) < 5e-3


def test_robots_that_cannot_follow_are_lost_and_the_motion_ends() -> None:
    weak = replace(_arm(), effort=(30.0, 9.0))
    (lost,) = follow([weak], _swing(True, seconds=0.2))
    assert len(lost.error) < 200
    assert np.max(lost.error[-1]) >= 0.1
    assert np.any(lost.torque > weak.effort)


def test_distances_are_those_of_boxes() -> None:
    straight = replace(_arm(), base=np.eye(4))
    beside = np.eye(4)
    beside[0, 3] = 0.35
    robots = [straight, replace(straight, name="other", base=beside)]
    with closing(RobotDistances(robots)) as world:
        assert world.least([np.zeros(2), np.zeros(2)]) == pytest.approx(0.25, abs=1e-5)
        # The other leans over by 0.1 rad: its lower corner moves little, its upper one away.
        turned = world.along([np.zeros((2, 2)), np.array([[0.0, 0.0], [0.1, 0.0]])])
    lower = 0.35 - 0.05 * np.cos(0.1) - 0.05
    np.testing.assert_allclose(turned, [0.25, lower], atol=1e-4)


def test_distances_of_robots_made_of_meshes_are_those_of_the_audit() -> None:
    model = robot_model("gp4")
    beside = np.eye(4)
    beside[0, 3] = 0.5
    placed = [
        PlacedRobot(name, model, base, model.home)
        for name, base in (("left", np.eye(4)), ("right", beside))
    ]
    stands = [model.home, model.home + 0.2]
    with closing(RobotDistances([described_robot(r, {}, []) for r in placed])) as world:
        found = world.least(stands)
    with closing(open_world(Workcell(tuple(placed), (), ()), "coal")) as audit:
        for k, q in enumerate(stands):
            audit.configure(k, q)
        left, right = (
            [shape for shape in audit.robot_shapes if shape.robot == k] for k in (0, 1)
        )
        least = min(audit.distance(a, b, 0.5) for a in left for b in right)
    assert 0.01 < least < 0.5
    assert found == pytest.approx(least, abs=1e-4)
