"""Robot models for visualization: links, joints and triangle meshes.

Each robot of a team has its own colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio

from planning.cell.workcell import PlacedRobot
from planning.transforms import Array, Transform
from twin.drawing.looks import painted_description
from twin.drawing.visual_shapes import read_visual_shapes, shape_triangles


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
    model, shown = read_visual_shapes(description, robot)
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
        vertices, faces = shape_triangles(item.geometry)
        corners = vertices[faces.reshape(-1)]
        rgba = tuple(np.asarray(item.meshColor, dtype=float).tolist())
        bodies.append(DrawnBody(link, corners @ own[:3, :3].T + own[:3, 3], rgba))
    return DrawnRobot(tuple(carriers), tuple(links), tuple(bodies))
