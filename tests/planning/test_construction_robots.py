"""The robots of construction sites: what is drawn lies within what collisions are decided with."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from planning.kinematics import frame_pose
from planning.robots.lattice import MESHES, crane_meshes
from planning.robots.registry import robot_model
from planning.robots.urdf_file import mesh_places
from planning.transforms import identity
from planning.workcell import PlacedRobot


def test_committed_lattices_are_what_the_code_draws() -> None:
    for name, text in crane_meshes().items():
        assert (MESHES / name).read_text() == text


def test_boxes_of_the_mobile_iiwa_contain_its_meshes() -> None:
    model = robot_model("mobile-iiwa14")
    boxes = {part.body.name: part.body.vertices for part in model.parts}
    root = ElementTree.parse(model.urdf).getroot()
    seen = 0
    for link in root.findall("link"):
        mesh = link.find("visual/geometry/mesh")
        if mesh is None:
            continue
        places = mesh_places(str(mesh.get("filename")), model.package_dirs)
        path = next(place for place in places if place.is_file())
        rows = [line.split() for line in path.read_text().splitlines()]
        points = np.array([row[1:4] for row in rows if row[:1] == ["v"]], dtype=float)
        # The meshes hang on links that joints move, but for the first, which is mounted.
        if link.get("name") == "iiwa_link_0":
            points[:, 2] += 0.59
        box = boxes[f"{link.get('name')}_0"]
        assert np.all(points >= box.min(axis=0) - 1e-4)
        assert np.all(points <= box.max(axis=0) + 1e-4)
        seen += 1
    assert seen == 8


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
