"""Shape of a tool that rests in its rack."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from planning.cell.robot_model import RobotModel
from planning.cell.shape import Element, Mesh, Shape, shape_of
from planning.transforms import Array, Transform, inverse, read_only_copy


def tool_shape(name: str, model: RobotModel, mount: Transform) -> Shape:
    """Return the shape of a robot's tool: the convex hulls of its bodies.

    Args:
        name: name of the tool.
        model: the robot with the tool mounted.
        mount: pose of the tool in the flange frame.
    """
    own = inverse(model.flange @ mount)
    elements = (
        Element(
            convex_hull_mesh(part.body.vertices, own, name), read_only_copy(np.eye(4))
        )
        for part in model.parts
        if part.group == "tool"
    )
    return shape_of(name, tuple(elements))


def convex_hull_mesh(vertices: Array, pose: Transform, source: str) -> Mesh:
    """Return the convex hull of points as a mesh.

    Args:
        vertices: the points, shape (v, 3) [m].
        pose: of their frame in that of the mesh.
        source: of the mesh, for messages.
    """
    corners = vertices @ pose[:3, :3].T + pose[:3, 3]
    hull = ConvexHull(corners)
    middle = corners.mean(axis=0)
    faces = hull.simplices.astype(np.int64)
    a, b, c = (corners[faces[:, k]] - middle for k in range(3))
    outwards = np.einsum("ij,ij->i", np.cross(a, b), c)
    faces[outwards < 0.0] = faces[outwards < 0.0][:, ::-1]
    weights = np.abs(outwards)
    centre = middle + (weights @ (a + b + c)) / (4.0 * weights.sum())
    faces.setflags(write=False)
    return Mesh(
        read_only_copy(corners),
        faces,
        (read_only_copy(corners),),
        float(hull.volume),
        read_only_copy(centre),
        source=source,
    )
