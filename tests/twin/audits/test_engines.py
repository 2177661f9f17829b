"""Both engines measure the same as the formulas of shapes, and the one asked for is used."""

import sys
from contextlib import closing, suppress
from itertools import combinations
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
from planning.contacts.touching import nearby_entities
from planning.errors import RequestError
from planning.robots.registry import robot_model
from planning.transforms import Transform, from_rpy, rotation, translation
from scheduling.witness.measuring import Measuring
from scheduling.witness.parts import measure, resting_parts
from tests.planning.cell.round_forms import stands_out
from tests.shipped_runs import ShippedRuns
from tests.twin.audits.audit_cell import HandWrittenRun, brick, reach, two_arm_cell
from twin.audits.audit import AuditReport, audit_run
from twin.audits.motion.pairs import SLACK
from twin.audits.worlds.engines import (
    Engine,
    engine_named,
)
from twin.audits.worlds.world import AuditWorld, WatchedShape, shapes_by_entity

NEAR = 0.05

TOLERANCE = 2e-4
"""Bullet rounds the edges of cylinders off; apart, it may say more than coal by this [m]."""

with suppress(ImportError):
    from twin.audits.worlds.bullet_world import BulletWorld

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


def _scatter(world: AuditWorld, bullet: BulletWorld, rng: np.random.Generator) -> None:
    """Put robots and boxes of both worlds at the same random places, boxes near robots."""
    for k, robot in enumerate(world.cell.robots):
        q = rng.uniform(robot.model.lower, robot.model.upper)
        frames = world.robots[k].joint_frames(q)
        for other in (world, bullet):
            other.configure(k, q)
        np.testing.assert_allclose(bullet.hand(k), frames[-1], atol=1e-6)
        for box in range(k, len(world.objects), 2):
            own = [shape for shape in world.robot_shapes if shape.robot == k]
            shape = own[int(rng.integers(len(own)))]
            link = frames[shape.joint + 1]
            middle = link[:3, :3] @ shape.centre + link[:3, 3]
            pose = from_rpy(middle + rng.normal(0.0, 0.08, 3), rng.uniform(-3, 3, 3))
            for other in (world, bullet):
                other.place(world.objects[box], pose)


def _links(world: AuditWorld) -> list[list[WatchedShape]]:
    """The shapes of each link, and each object: Bullet looks at links whole."""
    links: dict[str, list[WatchedShape]] = {}
    for shape in (*world.robot_shapes, *world.objects):
        links.setdefault(shape.detail, []).append(shape)
    return list(links.values())


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
    world = AuditWorld(_pair_of(names, rng.uniform(0.02, 0.2, (4, 3))))
    with closing(BulletWorld(world)) as bullet:
        apart, deep = [0.0], [0.0]
        for _ in range(60):
            _scatter(world, bullet, rng)
            for one, other in combinations(_links(world), 2):
                if one[0].robot is not None and one[0].robot == other[0].robot:
                    continue
                by_coal = min(world.distance(a, b, NEAR) for a in one for b in other)
                by_bullet = bullet.distance(one[0], other[0], NEAR)
                side = deep if min(by_bullet, by_coal) <= 0.0 else apart
                side.append(by_bullet - by_coal)
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
def test_what_lasts_is_seen_by_bullet_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It looks at samples: what the motion ends in is among them."""
    both = _crash(tmp_path / "both", "pybullet")
    monkeypatch.setattr(Measuring, "too_close", lambda *_, **__: iter(()))
    alone = _crash(tmp_path / "alone", "pybullet")
    seen, same = (
        {(v.first, v.second) for v in r.violations if v.kind == "contact"}
        for r in (both, alone)
    )
    assert ("left/arm", "right/arm") in same
    assert same <= seen


@pytest.mark.nightly
@needs_pybullet
@pytest.mark.parametrize(
    ("name", "robots"),
    [("lego/cliff", None), ("multi_arm/multi_goal", None), ("construction/tower", 2)],
)
def test_bullet_sees_nothing_more_in_shipped_runs(
    shipped: ShippedRuns, name: str, robots: int | None
) -> None:
    folder = shipped(name, robots).trial.files
    bullet = audit_run(folder, engine="pybullet")
    coal = audit_run(folder, engine="coal")
    assert bullet.violations == coal.violations == ()
    assert bullet.min_distance_m == coal.min_distance_m


def _alone(urdf: Path) -> AuditWorld:
    model = robot_model(str(urdf))
    robot = PlacedRobot("r", model, np.eye(4), model.home)
    return AuditWorld(Workcell((robot,), (), ()))


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
    world = _alone(urdf)
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


def test_distances_of_cylinders_are_true(tmp_path: Path) -> None:
    """Oracle: projections from one to the other and back, which end at the nearest points."""
    urdf = tmp_path / "rolls.urdf"
    urdf.write_text(ROLLS)
    world = _alone(urdf)
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
        first, second = world.robot_shapes
        found = world.distance(first, second, 1.0)
        assert found == pytest.approx(expected, abs=2e-6)
    assert apart > 4


def test_without_pybullet_coal_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "twin.audits.worlds.bullet_world", None)
    assert engine_named(None) == "coal"
    assert engine_named("coal") == "coal"
    with pytest.raises(RequestError, match=r"pip install 'assembly-twin\[audit\]'"):
        engine_named("pybullet")


def test_unknown_engines_are_refused() -> None:
    with pytest.raises(RequestError, match=r"fcl.*valid: pybullet, coal"):
        engine_named("fcl")


FAR = 0.3
_WEDGE = trimesh.creation.icosphere(1, 0.06).apply_scale((1.0, 0.6, 0.4))


def wedge() -> Mesh:
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


def exact(one: CellObject, other: CellObject) -> float:
    """Return coal's distance of the forms themselves, one pair after another."""
    eye = np.eye(4)
    return min(
        measure(a, eye, b, eye)
        for a in resting_parts("a", one.shape, one.start)
        for b in resting_parts("b", other.shape, other.start)
    )


def engine_distance(world: AuditWorld, measured: BulletWorld | None = None) -> float:
    by_name = shapes_by_entity(world.objects)
    distance = (measured or world).distance
    return min(distance(a, b, FAR) for a in by_name["one"] for b in by_name["other"])


@needs_pybullet
@settings(max_examples=60, deadline=None)
@given(compounds, compounds, places, places)
def test_engines_and_planning_agree_on_compounds(
    first: list[Element], second: list[Element], at: Transform, there: Transform
) -> None:
    one = CellObject("one", "part", shape_of("one", first), at)
    other = CellObject("other", "part", shape_of("other", second), there)
    cell = Workcell((), (), (one, other))
    world = AuditWorld(cell)
    by_coal = engine_distance(world)
    with closing(BulletWorld(world)) as other_world:
        for shape in world.objects:
            other_world.place(shape, shape.at(at if shape.entity == "one" else there))
        bullet = engine_distance(world, other_world)
    true = exact(one, other)
    assert by_coal == pytest.approx(min(true, FAR), abs=1e-5)
    if true > 0.0:
        assert bullet == pytest.approx(by_coal, abs=2e-4)
    else:
        assert bullet <= 2e-4
    seen = nearby_entities((one, at), {"other": (other, there)}, FAR).get("other", FAR)
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
def test_a_ball_in_the_middle_of_a_disc_leaves_it_through_an_end(
    radius: float, length: float, ball: float
) -> None:
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
    world = AuditWorld(Workcell((), (), (disc, inside)))
    assert engine_distance(world) == depth


def test_a_pin_fits_a_hole_that_is_a_little_wider() -> None:
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
        world = AuditWorld(Workcell((), (), (pin, other)))
        assert engine_distance(world) == pytest.approx(gap, abs=1e-6)
    assert isinstance(resting_parts("p", pin.shape, np.eye(4))[0].shape, coal.Cylinder)
