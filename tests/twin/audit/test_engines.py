"""Both engines measure the same as the formulas of shapes, and the one asked for is used."""

import sys
from pathlib import Path

import coal
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from planning.cell.shape import (
    Box,
    Capsule,
    Cylinder,
    Element,
    Mesh,
    box_shape,
    shape_of,
)
from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.contacts.touching import near_to
from planning.errors import RequestError
from planning.robots.registry import robot_model
from planning.transforms import from_rpy, rotation, translation
from scheduling.witness.parts import measure, resting_parts
from scheduling.witness.robot import WitnessRobot
from tests.planning.cell.round_forms import stands_out
from tests.shipped_runs import ShippedRuns
from tests.twin.audit.audit_cell import HandWrittenRun, brick, reach, two_arm_cell
from twin.audit.audit import AuditReport, audit_run
from twin.audit.motion.movers import STEP
from twin.audit.motion.pairs import SLACK
from twin.audit.worlds.coal_world import CoalWorld
from twin.audit.worlds.engines import (
    Engine,
    engine_and_version,
    engine_named,
    open_world,
)
from twin.audit.worlds.link_chain import JointAxes, measured_chain
from twin.audit.worlds.world import AuditWorld, WatchedShape, shapes_by_entity

NEAR = 0.05

TOLERANCE = 2e-4
"""Bullet rounds the edges of cylinders off; apart, it may say more than coal by this [m]."""

needs_pybullet = pytest.mark.skipif(
    engine_named(None) != "pybullet", reason="PyBullet is not installed"
)


def _pair_of(names: tuple[str, str], sizes: np.ndarray) -> Workcell:
    robots = tuple(
        PlacedRobot(
            f"r{k}", model, from_rpy([0.5 * k, 0.1, 0], [0, 0, 2.0 * k]), model.home
        )
        for k, model in enumerate(map(robot_model, names))
    )
    boxes = tuple(
        CellObject(f"b{k}", "box", box_shape(f"b{k}", size), np.eye(4))
        for k, size in enumerate(sizes)
    )
    return Workcell(robots, (), boxes)


def _scatter(worlds: list[AuditWorld], rng: np.random.Generator) -> None:
    """Put robots and boxes of both worlds at the same random places, boxes near robots."""
    bullet = worlds[0]
    for k, robot in enumerate(bullet.cell.robots):
        q = rng.uniform(robot.model.lower, robot.model.upper)
        turn, there = bullet.link_frames(k, q[None])
        same_turn, same_there = worlds[1].link_frames(k, q[None])
        np.testing.assert_allclose(same_turn, turn, atol=1e-6)
        np.testing.assert_allclose(same_there, there, atol=1e-6)
        for world in worlds:
            world.configure(k, q)
        for box in range(k, len(bullet.objects), 2):
            own = [shape for shape in bullet.robot_shapes if shape.robot == k]
            shape = own[int(rng.integers(len(own)))]
            link = shape.joint + 1
            middle = turn[0, link] @ shape.centre + there[0, link]
            pose = from_rpy(middle + rng.normal(0.0, 0.08, 3), rng.uniform(-3, 3, 3))
            for world in worlds:
                world.place(world.objects[box], pose)


def _shapes(world: AuditWorld) -> list[WatchedShape]:
    return [*world.robot_shapes, *world.objects]


@needs_pybullet
@pytest.mark.parametrize(
    "names",
    [
        ("gp4", "gp4"),
        ("panda", "iiwa14"),
        ("mobile-iiwa14", "tower-crane"),
        ("mobile-manipulator", "panda"),
    ],
)
def test_both_engines_measure_the_same(names: tuple[str, str]) -> None:
    """Oracle: the other engine, over random configurations and places of boxes."""
    rng = np.random.default_rng(11)
    cell = _pair_of(names, rng.uniform(0.02, 0.2, (4, 3)))
    engines: tuple[Engine, ...] = ("pybullet", "coal")
    worlds = [open_world(cell, engine) for engine in engines]
    for name, limits in worlds[0].limits.items():
        other = worlds[1].limits[name]
        assert (limits.names, limits.units) == (other.names, other.units)
        np.testing.assert_allclose(limits.lower, other.lower)
        np.testing.assert_allclose(limits.upper, other.upper)
        np.testing.assert_allclose(limits.velocity, other.velocity)
    for axes, others in zip(worlds[0].axes, worlds[1].axes, strict=True):
        np.testing.assert_allclose(axes.direction, others.direction, atol=1e-12)
        np.testing.assert_array_equal(axes.prismatic, others.prismatic)
    pairs = list(zip(*map(_shapes, worlds), strict=True))
    for a, b in pairs:
        assert (a.entity, a.detail, a.joint) == (b.entity, b.detail, b.joint)
    # The other witness knows the same parts.
    parts = [part for robot in cell.robots for part in WitnessRobot(robot).parts]
    told = [shape.entity for shape in worlds[0].robot_shapes]
    assert told == [part.entity for part in parts]
    apart, deep = [0.0], [0.0]
    for _ in range(60):
        _scatter(worlds, rng)
        for i, (a, same_a) in enumerate(pairs):
            for b, same_b in pairs[i + 1 :]:
                if a.robot is not None and a.robot == b.robot:
                    continue
                bullet = worlds[0].distance(a, b, NEAR)
                coal = worlds[1].distance(same_a, same_b, NEAR)
                side = deep if min(bullet, coal) <= 0.0 else apart
                side.append(bullet - coal)
    for world in worlds:
        world.close()
    assert len(deep) > 50
    assert len(apart) > 50
    assert np.max(np.abs(deep)) < SLACK / 2
    assert np.max(np.abs(apart)) < TOLERANCE
    assert min(*apart, *deep) > -SLACK / 2


def _crash(folder: Path, engine: Engine) -> AuditReport:
    """The left arm presses a brick on the plate, then leans into the right one."""
    cell = two_arm_cell([brick("b0", 0.4, 0.0)], gap=0.6)
    run = HandWrittenRun(cell)
    low = reach(cell, "left", 0.40, 0.0, 0.21)
    high = reach(cell, "left", 0.40, 0.0, 0.3)
    lean = high.copy()
    lean[1] += 0.5
    run.move("left", [0.0, 2.0, 4.0, 6.0], np.stack([high, low, high, lean]))
    run.stand("right", 6.0)
    return audit_run(run.write(folder), engine=engine)


@needs_pybullet
def test_both_engines_find_the_same_violations(tmp_path: Path) -> None:
    bullet, coal = (_crash(tmp_path / name, name) for name in ("pybullet", "coal"))
    assert bullet.violations
    seen, same = (
        [(v.first, v.second, v.kind) for v in r.violations] for r in (bullet, coal)
    )
    assert seen == same
    for one, other in zip(bullet.violations, coal.violations, strict=True):
        # What is too deep already is not looked at more finely.
        assert one.depth_m == pytest.approx(other.depth_m, abs=STEP)
        assert one.t_start == pytest.approx(other.t_start, abs=0.05)
    assert bullet.min_distance_m == pytest.approx(coal.min_distance_m, abs=SLACK)
    assert bullet.engine == engine_and_version("pybullet")
    assert coal.engine == engine_and_version("coal")


@pytest.mark.nightly
@needs_pybullet
@pytest.mark.parametrize(
    ("name", "robots"),
    [
        pytest.param("lego/cliff", None, marks=pytest.mark.nightly),
        ("multi_arm/multi_goal", None),
        ("construction/tower", 2),
    ],
)
def test_both_engines_give_the_same_verdict_on_shipped_runs(
    shipped: ShippedRuns, name: str, robots: int | None
) -> None:
    """Robots that are nearest may be rounded cylinders: Bullet says a little more there."""
    folder = shipped(name, robots).trial.folder
    bullet = audit_run(folder, engine="pybullet")
    coal = audit_run(folder, engine="coal")
    assert bullet.violations == coal.violations == ()
    assert bullet.min_distance_m == pytest.approx(coal.min_distance_m, abs=TOLERANCE)
    assert coal.configurations == pytest.approx(bullet.configurations, rel=0.05)


def _alone(urdf: Path, engine: Engine) -> AuditWorld:
    model = robot_model(str(urdf))
    robot = PlacedRobot("r", model, np.eye(4), model.home)
    return open_world(Workcell((robot,), (), ()), engine)


def test_coal_keeps_angles_of_continuous_joints(tmp_path: Path) -> None:
    """Oracle: the turn that the joint's angle means, beyond one whole turn."""
    urdf = tmp_path / "spinner.urdf"
    urdf.write_text(
        """<robot name="spinner">
  <link name="base"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
  <link name="hand"><collision><origin xyz="0.3 0 0"/>
    <geometry><sphere radius="0.05"/></geometry></collision></link>
  <joint name="spin" type="continuous"><parent link="base"/><child link="hand"/>
    <axis xyz="0 0 1"/><limit velocity="2" effort="1"/></joint>
</robot>"""
    )
    world = _alone(urdf, "coal")
    for angle in (-4.0, 0.3, 6.0):
        turn, _ = world.link_frames(0, np.array([[angle]]))
        expected = rotation("z", angle)[:3, :3]
        np.testing.assert_allclose(turn[0, 1], expected, atol=1e-12)
    limits = world.limits["r"]
    told = limits.lower[0], limits.upper[0], limits.velocity[0]
    assert told == (-np.inf, np.inf, 2)
    world.configure(0, np.array([np.pi / 2]))
    box, ball = world.robot_shapes
    assert (box.joint, ball.joint) == (-1, 0)
    assert world.distance(box, ball, 1.0) == pytest.approx(0.2, abs=1e-6)


ROLLS = """<robot name="rolls">
  <link name="base"><collision><geometry><cylinder radius="0.05" length="0.2"/></geometry>
  </collision></link>
  <link name="hand"><collision><origin xyz="0.12 0.03 0.05" rpy="0.4 1.1 0.2"/>
    <geometry><cylinder radius="0.04" length="0.15"/></geometry></collision></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="hand"/>
    <origin xyz="0.1 0.05 0.15"/><axis xyz="0 0.6 0.8"/>
    <limit lower="-3" upper="3" velocity="2" effort="1"/></joint>
</robot>"""


def _into(cylinder: tuple[np.ndarray, float, float], point: np.ndarray) -> np.ndarray:
    """The point of a cylinder (pose, radius, half length) that is nearest to another one."""
    pose, radius, half = cylinder
    local = pose[:3, :3].T @ (point - pose[:3, 3])
    local[:2] *= min(1.0, radius / max(float(np.linalg.norm(local[:2])), 1e-12))
    local[2] = np.clip(local[2], -half, half)
    return np.asarray(pose[:3, :3] @ local + pose[:3, 3])


@pytest.mark.parametrize(
    ("engine", "tolerance"),
    [pytest.param("pybullet", TOLERANCE, marks=needs_pybullet), ("coal", 2e-6)],
)
def test_distances_of_cylinders_are_true(
    tmp_path: Path, engine: Engine, tolerance: float
) -> None:
    """Oracle: projections from one to the other and back, which end at the nearest points."""
    urdf = tmp_path / "rolls.urdf"
    urdf.write_text(ROLLS)
    world = _alone(urdf, engine)
    axis = np.array([0.0, 0.6, 0.8])
    apart = 0
    for angle in np.linspace(-2.9, 2.9, 9):
        joint = translation(0.1, 0.05, 0.15)
        joint[:3, :3] = Rotation.from_rotvec(angle * axis).as_matrix()
        hand = joint @ from_rpy([0.12, 0.03, 0.05], [0.4, 1.1, 0.2])
        cylinders = (np.eye(4), 0.05, 0.1), (hand, 0.04, 0.075)
        there = hand[:3, 3]
        for _ in range(2000):
            here = _into(cylinders[0], there)
            there = _into(cylinders[1], here)
        expected = float(np.linalg.norm(here - there))
        if expected < 1e-4:
            continue
        apart += 1
        world.configure(0, np.array([angle]))
        found = world.distance(*world.robot_shapes, 1.0)
        assert found == pytest.approx(expected, abs=tolerance)
    world.close()
    assert apart > 4


def test_without_pybullet_coal_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "twin.audit.worlds.bullet_world", None)
    assert engine_named(None) == "coal"
    assert engine_named("coal") == "coal"
    with pytest.raises(RequestError, match=r"pip install 'assembly-twin\[audit\]'"):
        engine_named("pybullet")


def test_unknown_engines_are_refused() -> None:
    with pytest.raises(RequestError, match=r"fcl.*valid: pybullet, coal"):
        engine_named("fcl")


@pytest.mark.parametrize("name", ["gp4", "iiwa14", "mobile-manipulator"])
def test_a_chain_is_what_was_measured(name: str) -> None:
    model = robot_model(name)
    base = translation(0.1, 0.2, 0.3) @ rotation("z", 0.7)
    world = CoalWorld(Workcell((PlacedRobot("arm", model, base, model.home),), (), ()))
    assert world._chains[0] is not None
    q = np.random.default_rng(1).uniform(-3.0, 3.0, (20, model.dof))
    for own, told in zip(world.link_frames(0, q), world._measured(0, q), strict=True):
        assert np.allclose(own, told, rtol=0.0, atol=1e-12)


def test_joints_that_do_not_follow_one_another_are_left_to_the_engine() -> None:
    """Both joints turn about the base: the first does not carry the second."""

    def measure(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        turns = np.array(
            [[np.eye(3), *(_about_z(angle) for angle in row)] for row in q]
        )
        places = np.tile([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]], (len(q), 1, 1))
        return turns, places

    axes = JointAxes(np.array([[0.0, 0, 1]] * 2), np.array([False, False]))
    assert measured_chain(axes, (np.eye(3), np.zeros(3)), measure) is None


def _about_z(angle: float) -> np.ndarray:
    return rotation("z", angle)[:3, :3]


FAR = 0.3
_WEDGE = trimesh.creation.icosphere(1, 0.06).apply_scale((1.0, 0.6, 0.4))


def wedge():
    corners = np.array(_WEDGE.vertices) + np.array([0.02, 0.0, 0.01])
    return Mesh(corners, np.array(_WEDGE.faces), (corners,), 1e-4, np.zeros(3))


lengths = st.floats(0.01, 0.15)
forms = st.one_of(
    st.builds(lambda x, y, z: Box((x, y, z)), lengths, lengths, lengths),
    st.builds(Cylinder, lengths, lengths),
    st.builds(Capsule, lengths, st.one_of(st.just(0.0), lengths)),
    st.builds(wedge),
)
turns, shifts = st.floats(-3.0, 3.0), st.floats(-0.1, 0.1)
poses = st.builds(
    lambda *v: from_rpy(v[:3], v[3:]), shifts, shifts, shifts, turns, turns, turns
)
compounds = st.lists(st.builds(Element, forms, poses), min_size=1, max_size=3)
places = st.builds(
    lambda x, y, z, *turn: from_rpy((2.5 * x, 2.5 * y, 2.5 * z), turn),
    *(shifts,) * 3,
    *(turns,) * 3,
)


def exact(one, other):
    """Return coal's distance of the forms themselves, one pair after another."""
    eye = np.eye(4)
    return min(
        measure(a, eye, b, eye)
        for a in resting_parts("a", one.shape, one.start)
        for b in resting_parts("b", other.shape, other.start)
    )


def engine_distance(world):
    by_name = shapes_by_entity(world.objects)
    return min(
        world.distance(a, b, FAR) for a in by_name["one"] for b in by_name["other"]
    )


@needs_pybullet
@settings(max_examples=60, deadline=None)
@given(compounds, compounds, places, places)
def test_engines_and_planning_agree_on_compounds(first, second, at, there):
    one = CellObject("one", "part", shape_of("one", first), at)
    other = CellObject("other", "part", shape_of("other", second), there)
    cell = Workcell((), (), (one, other))
    found = []
    for engine in ("pybullet", "coal"):
        world = open_world(cell, engine)
        found.append(engine_distance(world))
        world.close()
    bullet, by_coal = found
    true = exact(one, other)
    assert by_coal == pytest.approx(min(true, FAR), abs=1e-5)
    if true > 0.0:
        assert bullet == pytest.approx(by_coal, abs=2e-4)
    else:
        assert bullet <= 2e-4
    seen = near_to((one, at), {"other": (other, there)}, FAR).get("other", FAR)
    out = max(
        [0.0]
        + [
            stands_out(item.form)
            for item in (*first, *second)
            if isinstance(item.form, Cylinder | Capsule)
        ]
    )
    if true > 0.0:
        # Planning never sees more room than there is, and no less than it says.
        assert seen <= min(true, FAR) + 1e-5
        assert seen >= min(true, FAR) - 2.0 * out - 1e-5


@pytest.mark.parametrize(
    ("radius", "length", "ball"), [(0.125, 0.125, 0.125), (0.15, 0.01, 0.1)]
)
def test_a_ball_in_the_middle_of_a_disc_leaves_it_through_an_end(radius, length, ball):
    eye = np.eye(4)
    shapes = [
        shape_of(name, [Element(form, eye)])
        for name, form in (
            ("disc", Cylinder(radius, length)),
            ("ball", Capsule(ball, 0.0)),
        )
    ]
    disc, inside = (
        CellObject(s, "part", shape, eye)
        for s, shape in zip(("one", "other"), shapes, strict=True)
    )
    depth = pytest.approx(-(0.5 * length + ball), abs=1e-5)
    assert exact(disc, inside) == depth
    world = open_world(Workcell((), (), (disc, inside)), "coal")
    assert engine_distance(world) == depth
    world.close()


def test_a_pin_fits_a_hole_that_is_a_little_wider():
    """Round against flat: exact forms keep apart what polyhedra would let touch."""
    pin = CellObject(
        "one",
        "pin",
        shape_of("pin", [Element(Cylinder(0.01, 0.05), np.eye(4))]),
        np.eye(4),
    )
    wall = Box((0.02, 0.1, 0.1))
    gap = 5e-5
    for angle in np.linspace(0.0, np.pi, 7):
        at = from_rpy((0, 0, 0), (0, 0, angle)) @ from_rpy(
            (0.02 + gap, 0, 0), (0, 0, 0)
        )
        other = CellObject(
            "other", "wall", shape_of("w", [Element(wall, np.eye(4))]), at
        )
        assert exact(pin, other) == pytest.approx(gap, abs=1e-6)
        world = open_world(Workcell((), (), (pin, other)), "coal")
        assert engine_distance(world) == pytest.approx(gap, abs=1e-6)
        world.close()
    assert isinstance(resting_parts("p", pin.shape, np.eye(4))[0].shape, coal.Cylinder)
