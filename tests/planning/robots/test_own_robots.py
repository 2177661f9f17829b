"""Robots of our own: the LEGO tools against measured dimensions, and what is drawn of construction robots within what decides."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from planning.cell.workcell import PlacedRobot
from planning.errors import RobotModelError
from planning.kinematics.kinematics import frame_pose
from planning.lego.insertion.tool_room import tool_room
from planning.robots.descriptions.xml_files import find_mesh
from planning.robots.registry import ROBOTS, robot_model, with_tool
from planning.transforms import Array, from_rpy, identity, inverse
from tests.planning.robots.drawn_meshes import MESHES, own_meshes

# Millimetres from the face of the force sensor, z out of the flange.
CONE = (
    (10.1, 38.5),
    (12.0, 36.7),
    (16.0, 32.9),
    (20.0, 29.2),
    (24.0, 25.4),
    (28.0, 21.6),
    (32.0, 17.8),
    (36.0, 14.1),
    (40.0, 10.3),
    (42.0, 8.4),
)
"""Depth and radius of the dual-arm tool's cone."""
DISC = ((0.0, 40.0), (5.0, 40.0), (10.0, 40.0))
SENSOR = 50.5
"""Length of the force sensor between flange and tool."""
ALL_ROUND = np.linspace(0.0, 2.0 * np.pi, 97)


def ring(profile: tuple[tuple[float, float], ...]) -> Array:
    """Points on a body of revolution."""
    return np.array(
        [(r * np.cos(a), r * np.sin(a), z) for z, r in profile for a in ALL_ROUND]
    )


def box(low: tuple[float, ...], high: tuple[float, ...]) -> Array:
    """Points on the sides of a box along z."""
    out = []
    for z in np.linspace(low[2], high[2], 9):
        for share in np.linspace(0.0, 1.0, 9):
            x, y = (low[k] + share * (high[k] - low[k]) for k in (0, 1))
            out += [(x, low[1], z), (x, high[1], z), (low[0], y, z), (high[0], y, z)]
    return np.array(out)


def octagon(near: float, far: float, low: float, high: float) -> Array:
    """Points at a distance on the sides along the axes, and further out on the corners."""
    out = []
    for z in np.linspace(low, high, 7):
        out += [(near, 0, z), (-near, 0, z), (0, near, z), (0, -near, z)]
        at = far / np.sqrt(2.0)
        out += [(x, y, z) for x in (-at, at) for y in (-at, at)]
    return np.array(out)


MEASURED = {
    ("gp4", "disc"): ring(DISC),
    ("gp4", "cone"): ring(CONE),
    ("gp4", "tip"): box((-8.0, -8.0, 44.0), (8.0, 8.0, 60.0)),
    ("gp4", "lever"): np.array(
        [(x, y, 62.0) for x in (-5.2, 0.0) for y in np.linspace(-8, 8, 9)]
        + [(x, y, 63.7) for x in (-5.2, 0.0) for y in np.linspace(-8, 8, 9)]
    ),
    ("gp4", "fin"): np.array(
        [(x, -46.25, z) for x in (-8.0, 0.0, 8.0) for z in (11.0, 20.0, 33.0, 44.0)]
    ),
    ("gp4", "fin inwards"): np.array(
        [(x, -16.0, z) for x in (-8.0, 0.0, 8.0) for z in (37.0, 40.0, 44.0)]
    ),
    ("gp4-slim-tool", "disc"): ring(DISC),
    ("gp4-slim-tool", "body"): octagon(11.2, 14.2, 10.2, 38.0),
    ("gp4-slim-tool", "tip"): np.array(
        [(-9.9, y, z) for y in (-8.0, 0.0, 8.0) for z in (40.1, 50.0, 63.7)]
        + [(x, y, z) for x in (-5.0, 0.0) for y in (-8.0, 8.0) for z in (45.0, 63.7)]
    ),
}
"""Points on the surface of each tool, by part."""


def pieces(name: str) -> list[ConvexHull]:
    """The convex pieces of a tool, in millimetres from the face of the force sensor."""
    model = robot_model(name)
    to_flange = inverse(model.flange)
    hulls = []
    for part in model.parts:
        if part.group == "tool":
            corners = part.body.vertices @ to_flange[:3, :3].T + to_flange[:3, 3]
            hulls.append(ConvexHull(corners * 1e3 - [0.0, 0.0, SENSOR]))
    return hulls


def outside(hull: ConvexHull, points: Array) -> Array:
    """Greatest signed distance of each point from the planes of a hull; negative inside."""
    planes = hull.equations
    return np.asarray((points @ planes[:, :3].T + planes[:, 3]).max(axis=1))


@pytest.mark.parametrize(("name", "part"), MEASURED)
def test_tools_are_half_a_millimetre_around_what_was_measured(
    name: str, part: str
) -> None:
    """No measured point is outside of the model, and none deeper in it than 0.5 mm."""
    depth = np.array([outside(hull, MEASURED[name, part]) for hull in pieces(name)])
    depth = depth.min(axis=0)
    assert depth.max() <= 1e-6
    assert depth.min() >= -0.5


def test_the_arm_is_the_same_with_either_tool() -> None:
    trees = []
    for name in ("gp4", "gp4-slim-tool"):
        root = ElementTree.parse(robot_model(name).urdf).getroot()
        for link in root.findall("link"):
            if link.get("name") == "tool":
                root.remove(link)
        trees.append(ElementTree.tostring(root))
    assert trees[0] == trees[1]


def test_a_tool_is_chosen_by_name() -> None:
    assert with_tool("gp4", None) == "gp4"
    assert with_tool("gp4", "slim") == "gp4-slim-tool"
    assert with_tool("gp4-slim-tool", "dual-arm") == "gp4"
    for model, tool, words in (
        ("gp4", "thin", "'thin'"),
        ("panda", "slim", "no tools"),
    ):
        with pytest.raises(RobotModelError, match=words):
            with_tool(model, tool)
    for entry in ROBOTS.values():
        assert all(ROBOTS[name].tools == entry.tools for name in entry.tools.values())


@pytest.mark.parametrize("name", ["gp4", "gp4-slim-tool"])
def test_boxes_for_sequencing_are_around_the_bodies_and_close(name: str) -> None:
    """Every corner of a tool's body lies in a box; no box reaches where no body is."""
    shape, model = tool_room(name), robot_model(name)
    to_tool = inverse(model.flange @ model.frames["tool"])
    corners = np.vstack(
        [
            part.body.vertices @ to_tool[:3, :3].T + to_tool[:3, 3]
            for part in model.parts
            if part.group == "tool"
        ]
    )
    for rpy in ((0.0, 0.0, 0.0), (np.pi, 0.3, 0.2), (0.4, 1.2, -0.9)):
        pose = from_rpy((0.3, -0.1, 0.2), rpy)
        boxes = shape.boxes_at(pose)
        there = corners @ pose[:3, :3].T + pose[:3, 3]
        inside = (there[:, None] >= boxes[:, 0] - 1e-9) & (
            there[:, None] <= boxes[:, 1] + 1e-9
        )
        assert np.all(inside, axis=2).any(axis=1).all()
        assert boxes[:, 0].min(axis=0) == pytest.approx(
            np.vstack([there, shape.pieces[0] @ pose[:3, :3].T + pose[:3, 3]]).min(
                axis=0
            ),
            abs=0.06,
        )


def test_committed_meshes_are_what_the_code_draws() -> None:
    for name, text in own_meshes().items():
        assert (MESHES / name).read_text() == text


def test_boxes_of_the_mobile_iiwa_contain_its_meshes() -> None:
    model = robot_model("mobile-iiwa14")
    root = ElementTree.parse(model.urdf).getroot()
    seen = 0
    for link in root.findall("link"):
        mesh = link.find("visual/geometry/mesh")
        if mesh is None:
            continue
        file = find_mesh(str(mesh.get("filename")), model.package_dirs)
        assert file is not None
        points = _surface(file)
        # The meshes hang on links that joints move, but for the first, which is mounted.
        if link.get("name") == "iiwa_link_0":
            points[:, 2] += 0.49
        inside = np.zeros(len(points), dtype=bool)
        for part in model.parts:
            if part.body.name.startswith(f"{link.get('name')}_"):
                low, high = (f(part.body.vertices, axis=0) for f in (np.min, np.max))
                inside |= np.all((points >= low) & (points <= high), axis=1)
        assert inside.all(), (link.get("name"), points[~inside][:5])
        seen += 1
    assert seen == 8


def _surface(path: Path) -> Array:
    """Return points all over the triangles of a Wavefront OBJ file, shape (p, 3)."""
    rows = [line.split() for line in path.read_text().splitlines()]
    vertices = np.array([row[1:4] for row in rows if row[:1] == ["v"]], dtype=float)
    faces = [[int(f.split("/")[0]) - 1 for f in r[1:]] for r in rows if r[:1] == ["f"]]
    corners = vertices[[f for f in faces if len(f) == 3]]
    assert len(corners) == len(faces)
    weights = np.array(
        [(i, j, 6 - i - j) for i in range(7) for j in range(7 - i)], dtype=float
    )
    return np.asarray(np.einsum("wk,fkx->fwx", weights / 6.0, corners)).reshape(-1, 3)


@pytest.mark.parametrize("name", ["mobile-manipulator", "mobile-iiwa14", "tower-crane"])
def test_pad_ends_at_the_tool_frame(name: str) -> None:
    model = robot_model(name)
    tool = np.linalg.inv(model.flange @ model.frames["tool"])
    pad = [p.body.vertices for p in model.parts if p.group == "tool"]
    heights = [(v @ tool[:3, :3].T + tool[:3, 3])[:, 2] for v in pad]
    assert max(h.max() for h in heights) == pytest.approx(0.0, abs=1e-9)
    at_home = frame_pose(PlacedRobot("a", model, identity(), model.home), model.home)
    down = at_home @ model.frames["tool"]
    assert down[2, 2] == pytest.approx(-1.0, abs=1e-6)  # every pad hangs down at HOME


@pytest.mark.parametrize("name", ["mobile-manipulator", "mobile-iiwa14"])
def test_wheels_clear_the_floor(name: str) -> None:
    model = robot_model(name)
    platform = [p.body.vertices for p in model.parts if p.joint == 2]
    assert min(v[:, 2].min() for v in platform) == pytest.approx(0.005)
