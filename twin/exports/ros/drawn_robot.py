"""Robot models for visualization: links, joints and triangle meshes.

Each robot of a team has its own colour.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio

from planning.cell.shape import Box, Capsule, Cylinder
from planning.cell.workcell import PlacedRobot
from planning.robots.descriptions.fitting import written_options
from planning.robots.registry import ROBOTS
from planning.transforms import Array, Transform
from twin.drawing.looks import painted_description
from twin.drawing.triangles import corners_of

Element = ElementTree.Element


@dataclass(frozen=True, eq=False)
class DrawnLink:
    """A link of a robot.

    Attributes:
        name: in the description.
        joint: number of the moved joints that move it, 0 for the base.
        pose: in the frame after the motion of the last of these joints, or of the base.
    """

    name: str
    joint: int
    pose: Transform


@dataclass(frozen=True, eq=False)
class DrawnBody:
    """A body that a link shows.

    Attributes:
        link: name of the link.
        corners: three rows per triangle, in the frame of the link, shape (3 k, 3) [m].
        colour: red, green, blue and opacity, 0 to 1.
    """

    link: str
    corners: Array
    colour: tuple[float, float, float, float]


@dataclass(frozen=True)
class DrawnRobot:
    """A robot as it is shown.

    Attributes:
        carriers: links whose frames are those of the base and after each moved joint.
        links: all others.
        bodies: the visible bodies.
    """

    carriers: tuple[str, ...]
    links: tuple[DrawnLink, ...]
    bodies: tuple[DrawnBody, ...]


def drawn_robot(robot: PlacedRobot, colour: tuple[int, int, int]) -> DrawnRobot:
    """Return a robot in its colour.

    Args:
        robot: the robot.
        colour: red, green and blue, 0 to 255.
    """
    description = painted_description(robot, colour).getroot()
    _leave_out_lost(description)
    model, shown = _read(description, robot)
    links = []
    carriers = [""] * (robot.model.dof + 1)
    poses: dict[str, Transform] = {}
    for frame in model.frames:
        if frame.type != pinocchio.FrameType.BODY:
            continue
        pose = np.array(frame.placement.homogeneous)
        poses[frame.name] = pose
        joint = int(frame.parentJoint)
        if not carriers[joint] and np.array_equal(pose, np.eye(4)):
            carriers[joint] = frame.name
        else:
            links.append(DrawnLink(frame.name, joint, pose))
    bodies = []
    for item in shown.geometryObjects:
        link = model.frames[item.parentFrame].name
        own = np.linalg.solve(poses[link], np.array(item.placement.homogeneous))
        corners = _corners(item.geometry)
        rgba = tuple(np.asarray(item.meshColor, dtype=float).tolist())
        bodies.append(DrawnBody(link, corners @ own[:3, :3].T + own[:3, 3], rgba))
    return DrawnRobot(tuple(carriers), tuple(links), tuple(bodies))


def _read(description: Element, robot: PlacedRobot) -> tuple[Any, Any]:
    """Return kinematic model and visual geometry of a URDF, reduced to the moved joints."""
    text = ElementTree.tostring(description, encoding="unicode")
    model = pinocchio.buildModelFromXML(text)
    kind = pinocchio.GeometryType.VISUAL
    shown = pinocchio.buildGeomFromUrdfString(model, text, kind)
    moved = set(robot.model.joint_names)
    others = [name for name in model.names[1:] if name not in moved]
    if others:
        known = written_options(description)
        held = (known or ROBOTS[robot.model.name]).frozen
        still = pinocchio.neutral(model)
        for name in others:
            still[model.joints[model.getJointId(name)].idx_q] = held[name]
        ids = [model.getJointId(name) for name in others]
        model, shown = pinocchio.buildReducedModel(model, shown, ids, still)
    return model, shown


def _leave_out_lost(root: Element) -> None:
    """Remove bodies whose mesh file is missing."""
    for link in root.findall("link"):
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is not None and not Path(mesh.get("filename", "")).is_file():
                link.remove(visual)


def _corners(shape: Any) -> Array:
    """Return the corners of the triangles of a shape of coal, shape (3 k, 3)."""
    kind = type(shape).__name__
    if kind == "Box":
        return corners_of(Box(tuple((2.0 * np.asarray(shape.halfSide)).tolist())))
    if kind in ("Cylinder", "Capsule", "Sphere"):
        length = 2.0 * float(getattr(shape, "halfLength", 0.0))
        turned = Cylinder if kind == "Cylinder" else Capsule
        return corners_of(turned(float(shape.radius), length))
    vertices = np.asarray(shape.vertices(), dtype=np.float64)
    faces = [shape.tri_indices(k) for k in range(shape.num_tris)]
    return np.asarray(vertices[[[f[0], f[1], f[2]] for f in faces]].reshape(-1, 3))
