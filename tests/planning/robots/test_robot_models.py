"""Robot descriptions: what is read from them, and what is said of unusable ones."""

import dataclasses
import os
from itertools import combinations
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio
import pytest

from planning.cell.robot_model import RobotModel
from planning.cell.workcell import PlacedRobot
from planning.errors import RobotModelError
from planning.kinematics.chain import joint_table, pose_joints
from planning.kinematics.kinematics import frame_pose
from planning.robots.descriptions.fitting import Fitting
from planning.robots.descriptions.urdf_file import UrdfOptions
from planning.robots.load_urdf import load_urdf, shape_vertices
from planning.robots.registry import ROBOTS, robot_model
from planning.transforms import Array, inverse
from tests.planning.robots.drawn_meshes import cone_obj
from tests.planted import rows

NAMES = sorted(ROBOTS)


def convex(vertices: Array) -> Any:
    points = coal.StdVec_Vec3s()
    for vertex in vertices:
        points.append(np.array(vertex))
    return coal.Convex.convexHull(points, False, "")


def part_distance(model: RobotModel, q: Array, a: int, b: int) -> float:
    poses = np.empty((model.dof + 1, 4, 4))
    pose_joints(joint_table(model), q, poses)
    placed = []
    for k in (a, b):
        pose = poses[model.parts[k].joint + 1]
        placed += [
            convex(model.parts[k].body.vertices),
            coal.Transform3s(np.array(pose[:3, :3]), np.array(pose[:3, 3])),
        ]
    return float(coal.distance(*placed, coal.DistanceRequest(), coal.DistanceResult()))


@pytest.mark.parametrize("name", NAMES)
def test_registered_robot_is_complete(name: str) -> None:
    model, entry = robot_model(name), ROBOTS[name]
    assert model.name == name
    assert model is robot_model(name)
    assert entry.note
    assert entry.licence
    assert model.urdf.is_file()
    assert np.all(model.lower <= model.home)
    assert np.all(model.home <= model.upper)
    assert np.all(model.velocity > 0.0)
    assert np.all(model.velocity < 20.0)
    assert "tool" in model.frames
    # Only the sliding axes of a mobile base and the ground under it carry nothing.
    bare = set(range(-1, model.dof)) - {part.joint for part in model.parts}
    mobile = model.joint_names[:3] == ("base_x", "base_y", "base_yaw")
    assert bare == ({-1, 0, 1} if mobile else set())
    names = [part.body.name for part in model.parts]
    assert len(set(names)) == len(names)
    assert np.allclose(np.linalg.norm(model.chain.axis, axis=1), 1.0)


@pytest.mark.parametrize(("name", "pieces"), [("gp4", 7), ("gp4-slim-tool", 4)])
def test_gp4_limits_and_tool(name: str, pieces: int) -> None:
    model = robot_model(name)
    assert np.allclose(np.degrees(model.lower), (-170, -110, -65, -200, -120, -450))
    assert np.allclose(np.degrees(model.upper), (170, 130, 200, 200, 120, 450))
    assert np.allclose(np.degrees(model.velocity), (370, 310, 410, 550, 545, 1000))
    tool = [part for part in model.parts if part.group == "tool"]
    assert len(tool) == pieces
    assert all(part.joint == 5 for part in tool)
    # The lever reaches 3.2 mm beyond the plane in which the tool grips a brick.
    flange_z = np.linalg.inv(model.flange)
    tips = [
        (part.body.vertices @ flange_z[:3, :3].T + flange_z[:3, 3])[:, 2].max()
        for part in tool
    ]
    grip = model.frames["tool"][2, 3]
    assert max(tips) == pytest.approx(grip + 0.0032, abs=1e-6)
    assert any(tip == pytest.approx(grip, abs=1e-6) for tip in tips)


def test_gripper_fingers_are_held_open() -> None:
    model = robot_model("panda")
    assert model.dof == 7
    fingers = [p.body.vertices for p in model.parts if "finger" in p.body.name]
    hand = np.linalg.inv(model.flange @ model.frames["tool"])
    sides = [(v @ hand[:3, :3].T + hand[:3, 3])[:, 1] for v in fingers]
    assert sides[0].min() == pytest.approx(-sides[1].max(), abs=1e-4)
    assert sides[0].min() == pytest.approx(0.02, abs=2e-3)


@pytest.mark.parametrize("name", NAMES)
def test_home_is_free_of_self_collision_without_exemptions(name: str) -> None:
    """Hulls of joints two or more apart do not even overlap at HOME: none was exempted so."""
    model = robot_model(name)
    for a, b in combinations(range(len(model.parts)), 2):
        if abs(model.parts[a].joint - model.parts[b].joint) > 1:
            assert part_distance(model, model.home, a, b) > 0.0


@pytest.mark.parametrize("name", NAMES)
def test_exempt_pairs_stay_apart_in_random_configurations(name: str) -> None:
    model = robot_model(name)
    rng = np.random.default_rng(77)
    proved = [
        (a, b)
        for a, b in sorted(model.never_collide)
        if abs(model.parts[a].joint - model.parts[b].joint) > 1
    ]
    assert proved
    for q in rng.uniform(model.lower, model.upper, (40, model.dof)):
        assert all(part_distance(model, q, a, b) > 0.0 for a, b in proved)


def test_folded_arm_is_seen_to_touch_itself() -> None:
    model = robot_model("gp4")
    q = np.radians([0.0, -20.0, -64.0, 0.0, -90.0, 0.0])
    touching = [
        (a, b)
        for a, b in combinations(range(len(model.parts)), 2)
        if (a, b) not in model.never_collide and part_distance(model, q, a, b) <= 0.0
    ]
    assert touching


@pytest.mark.parametrize("name", NAMES)
def test_parts_contain_the_collision_geometry(name: str) -> None:
    """Every vertex pinocchio loads lies in the hull of its part, checked by support planes."""
    model = robot_model(name)
    full = pinocchio.buildModelFromUrdf(str(model.urdf))
    geometry = pinocchio.buildGeomFromUrdf(
        full,
        str(model.urdf),
        pinocchio.GeometryType.COLLISION,
        package_dirs=[str(folder) for folder in model.package_dirs],
    )
    assert len(geometry.geometryObjects) == len(model.parts)
    rng = np.random.default_rng(5)
    directions = rng.normal(size=(300, 3))
    for item, part in zip(geometry.geometryObjects, model.parts, strict=True):
        if item.parentJoint > model.dof:
            continue  # a frozen finger: in the frame of the hand by now
        pose = item.placement.homogeneous
        shape = item.geometry
        points = round_points(shape, rng)
        points = points @ pose[:3, :3].T + pose[:3, 3]
        inner = (points @ directions.T).max(axis=0)
        outer = (part.body.vertices @ directions.T).max(axis=0)
        assert np.all(inner <= outer + 1e-9)


def round_points(shape: Any, rng: np.random.Generator) -> Array:
    """Points on a true shape, so on the round one and not on the polyhedron around it."""
    kind = type(shape).__name__
    if kind == "Box":
        half = np.asarray(shape.halfSide)
        return np.asarray(rng.uniform(-1.0, 1.0, (500, 3)) * half)
    angle = rng.uniform(0.0, 2.0 * np.pi, 3000)
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    if kind == "Cylinder":
        ends = rng.choice([-1.0, 1.0], 3000) * shape.halfLength
        return np.column_stack([ring * shape.radius, ends])
    if kind in ("Sphere", "Capsule"):
        z = rng.uniform(-1.0, 1.0, 3000)
        ball = np.column_stack([ring * np.sqrt(1.0 - z * z)[:, None], z]) * shape.radius
        if kind == "Capsule":
            ball[:, 2] += rng.choice([-1.0, 1.0], 3000) * shape.halfLength
        return np.asarray(ball)
    return np.asarray(shape.vertices())


@pytest.mark.parametrize(
    "shape",
    [coal.Cylinder(0.05, 0.3), coal.Sphere(0.07), coal.Capsule(0.04, 0.2)],
    ids=["cylinder", "sphere", "capsule"],
)
def test_polyhedra_contain_round_shapes(shape: Any) -> None:
    rng = np.random.default_rng(3)
    points = round_points(shape, rng)
    hull = convex(shape_vertices(shape, "part"))
    probe, result = coal.Sphere(1e-9), coal.DistanceResult()
    for point in points[:400]:
        at = coal.Transform3s(np.eye(3), point)
        result.clear()
        request = coal.DistanceRequest()
        assert (
            coal.distance(hull, coal.Transform3s(), probe, at, request, result) < 1e-8
        )
    loose = shape_vertices(shape, "part")
    assert (
        np.linalg.norm(loose, axis=1).max()
        < 1.02 * np.linalg.norm(points, axis=1).max()
    )


# -- descriptions of users ---------------------------------------------------------------

LINK = (
    '<link name="{}"><collision><geometry><box size="0.1 0.1 0.4"/></geometry>'
    '<origin xyz="0 0 0.2"/></collision></link>'
)


def joint(
    name: str, parent: str, child: str, kind: str = "revolute", **extra: str
) -> str:
    limit = extra.get("limit", '<limit lower="-1" upper="2" velocity="3" effort="1"/>')
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="0 0 0.4"/><axis xyz="0 2 0"/>{limit}</joint>'
    )


def write(folder: Path, *elements: str, links: str = "abcd") -> Path:
    path = folder / "arm.urdf"
    parts = [LINK.format(link) for link in links]
    path.write_text('<robot name="arm">' + "".join([*parts, *elements]) + "</robot>")
    return path


def test_own_urdf_is_read(tmp_path: Path) -> None:
    """Joints of three kinds, a fixed one merged, the last link taken as tool."""
    write(
        tmp_path,
        joint("slide", "a", "b", "prismatic"),
        joint("spin", "b", "c", "continuous"),
        joint("mount", "c", "tool0", "fixed", limit=""),
        joint("gripper_mount", "tool0", "gripper", "fixed", limit=""),
        links="abc",
    )
    path = tmp_path / "arm.urdf"
    extra = '<link name="tool0"/>' + LINK.format("gripper") + "</robot>"
    path.write_text(path.read_text().replace("</robot>", extra))
    model = robot_model("arm.urdf", tmp_path)
    assert model.name == "arm"
    assert model.joint_names == ("slide", "spin")
    assert list(model.chain.prismatic) == [True, False]
    assert np.allclose(model.lower, (-1.0, -2.0 * np.pi))
    assert np.allclose(model.upper, (2.0, 2.0 * np.pi))
    assert np.allclose(model.chain.axis, [[0.0, 1.0, 0.0]] * 2)
    assert np.allclose(model.home, 0.0)
    assert np.allclose(model.flange[:3, 3], (0.0, 0.0, 0.4))
    assert np.allclose(model.frames["tool"][:3, 3], (0.0, 0.0, 0.4))
    assert [(p.joint, p.group) for p in model.parts] == [
        (-1, "arm"),
        (0, "arm"),
        (1, "arm"),
        (1, "tool"),
    ]


def test_edited_urdf_is_read_anew(tmp_path: Path) -> None:
    path = write(tmp_path, joint("one", "a", "b"), links="ab")
    first = robot_model(str(path))
    assert robot_model(str(path)) is first
    path.write_text(path.read_text().replace('velocity="3"', 'velocity="4"'))
    os.utime(path, ns=(1, first.urdf.stat().st_mtime_ns + 10**9))
    assert robot_model(str(path)).velocity[0] == 4.0


def test_package_meshes_are_found_above_the_file(tmp_path: Path) -> None:
    """The usual layout: my_arm/urdf/arm.urdf names package://my_arm/meshes/cone.obj."""
    package = tmp_path / "my_arm"
    (package / "urdf").mkdir(parents=True)
    (package / "meshes").mkdir()
    (package / "meshes" / "cone.obj").write_text(cone_obj())
    path = write(package / "urdf", joint("one", "a", "b"), links="ab")
    mesh = '<mesh filename="package://my_arm/meshes/cone.obj"/>'
    path.write_text(path.read_text().replace('<box size="0.1 0.1 0.4"/>', mesh, 1))
    model = load_urdf(path)
    assert len(model.parts[0].body.vertices) == 48


NO_VELOCITY = '<limit lower="-1" upper="2" effort="1"/>'
ENDLESS = '<limit lower="-1" upper="2" velocity="inf" effort="1"/>'
LIMIT = '<limit lower="-1" upper="2" velocity="{}" effort="1"/>'
BACKWARDS = '<limit lower="2" upper="1" velocity="1" effort="1"/>'


@pytest.mark.parametrize(
    ("elements", "message"),
    [
        ([], "has no joints"),
        ([joint("one", "a", "b"), joint("two", "c", "d")], "one root link"),
        ([joint("one", "a", "b", "fixed", limit="")], "no moving joint"),
        ([joint("one", "a", "b", limit="")], "'one' has no <limit>"),
        ([joint("one", "a", "b", limit=NO_VELOCITY)], "velocity limit above zero"),
        (
            [joint("one", "a", "b", limit=LIMIT.format("1e300"))],
            "must be 0.001 to 1e\\+09",
        ),
        (
            [joint("one", "a", "b", limit=LIMIT.format("1e-9"))],
            "must be 0.001 to 1e\\+09",
        ),
        ([joint("one", "a", "b", limit=ENDLESS)], "must be a finite number, is 'inf'"),
        ([joint("one", "a", "b", limit=BACKWARDS)], "empty range: 2 to 1"),
        ([joint("one", "a", "x")], "no valid child link"),
        ([joint("one", "a", "b", "floating")], "type 'floating'"),
        (
            [joint("one", "a", "b"), joint("left", "b", "c"), joint("right", "b", "d")],
            "branches at joints 'left' and 'right'",
        ),
        (
            [joint("one", "a", "b"), '<xacro:arm xmlns:xacro="http://ros.org/xacro"/>'],
            "xacro macros",
        ),
    ],
)
def test_unusable_description_is_explained(
    tmp_path: Path, elements: list[str], message: str
) -> None:
    links = "abcd" if len(elements) > 1 and "xacro" not in elements[1] else "ab"
    path = write(tmp_path, *elements, links=links)
    with pytest.raises(RobotModelError, match=message):
        load_urdf(path)


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(RobotModelError, match=r"gone\.urdf does not exist"):
        robot_model("gone.urdf", tmp_path)


def test_unknown_name_lists_the_registry() -> None:
    with pytest.raises(RobotModelError, match="'ur5'") as caught:
        robot_model("ur5")
    assert set(ROBOTS) <= set(caught.value.choices)


def test_unknown_joint_to_freeze_and_unknown_flange(tmp_path: Path) -> None:
    path = write(tmp_path, joint("one", "a", "b"), links="ab")
    with pytest.raises(RobotModelError, match="no joint 'thumb'"):
        load_urdf(path, UrdfOptions(frozen={"thumb": 0.0}))
    with pytest.raises(RobotModelError, match="'hand' is no link"):
        load_urdf(path, UrdfOptions(flange_link="hand"))


def test_models_cannot_be_changed() -> None:
    model = robot_model("gp4")
    with pytest.raises(dataclasses.FrozenInstanceError):
        model.name = "gp5"  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        model.lower[0] = 0.0


@pytest.mark.parametrize(
    ("old", "new", "words"),
    rows(r"""
old          | new                    | says
<robot       | robot: <robot          | is not XML
robot        | sdf                    | root element is <sdf>
0.1 0.1 0.4  | 0.1 0.1 1e300          | size of a <box> must be 1e-06
0.1 0.1 0.4  | 0.1 0 0.4              | size of a <box> must be 1e-06
0.1 0.1 0.4  | 0.1 0.4                | must be 3 numbers
0.1 0.1 0.4  | 0.1 nan 0.4            | must be a finite number
<box size="0.1 0.1 0.4"/> | <mesh filename="meshes/hand.stl"/> | 'meshes/hand.stl' was not found
"""),
)
def test_what_cannot_be_read_is_explained(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    path = write(tmp_path, joint("spin", "a", "b", "revolute"), links="ab")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(RobotModelError, match=words):
        load_urdf(path)


def test_ur5e_has_the_kinematics_of_its_table() -> None:
    """Forward kinematics is the product of the maker's Denavit-Hartenberg rows."""
    rows = (  # d, a, alpha
        (0.1625, 0.0, np.pi / 2),
        (0.0, -0.425, 0.0),
        (0.0, -0.3922, 0.0),
        (0.1333, 0.0, np.pi / 2),
        (0.0997, 0.0, -np.pi / 2),
        (0.0996, 0.0, 0.0),
    )
    robot = PlacedRobot("r", robot_model("ur5e"), np.eye(4), robot_model("ur5e").home)
    # The maker's base frame is turned by half a turn against the one whose x axis points forward.
    turned = np.diag([-1.0, -1.0, 1.0, 1.0])
    for q in np.random.default_rng(5).uniform(-3.0, 3.0, (20, 6)):
        pose = turned
        for angle, (d, a, alpha) in zip(q, rows, strict=True):
            c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
            pose = pose @ np.array(
                [
                    [c, -s * ca, s * sa, a * c],
                    [s, c * ca, -c * sa, a * s],
                    [0.0, sa, ca, d],
                    [0.0, 0.0, 0.0, 1.0],
                ]
            )
        assert np.allclose(frame_pose(robot, q), pose, atol=1e-9)


def test_nothing_of_a_bare_ur5e_is_in_front_of_its_flange() -> None:
    """What stands proud would be in every tool that lies flat on the flange."""
    model = robot_model("ur5e", None, Fitting(bare=True))
    changer = [part for part in model.parts if part.group == "tool"]
    assert changer
    turn = inverse(model.flange)
    for part in changer:
        assert np.max(part.body.vertices @ turn[2, :3] + turn[2, 3]) <= 1e-9
