"""The robots of construction sites: what is drawn lies within what collisions are decided with."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

from planning.cell.workcell import PlacedRobot
from planning.kinematics.kinematics import frame_pose
from planning.robots.descriptions.xml_files import find_mesh
from planning.robots.registry import robot_model
from planning.transforms import Array, identity
from tests.planning.robots.drawn_meshes import MESHES, own_meshes


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
