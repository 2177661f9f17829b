"""Meshes of a robot, one for each joint: its visual shapes, and the convex bodies that the planner checks."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import trimesh

from planning.cell.robot_model import RobotModel
from planning.cell.workcell import PlacedRobot
from twin.drawing.looks import painted_description
from twin.drawing.visual_shapes import read_visual_shapes, shape_triangles

Meshes = dict[int, trimesh.Trimesh]
"""Mesh of what is moved by one joint, in its frame, by the number of the joint; 0 is the base."""


def visual_meshes(robot: PlacedRobot, colour: tuple[int, int, int]) -> Meshes:
    """Return the visual shapes of a robot in its colour, red, green and blue from 0 to 255."""
    found = defaultdict[int, list[trimesh.Trimesh]](list)
    description = painted_description(robot, colour).getroot()
    for item in read_visual_shapes(description, robot)[1].geometryObjects:
        own = np.round(255 * np.clip(item.meshColor, 0.0, 1.0)).astype(np.uint8)
        mesh = trimesh.Trimesh(*shape_triangles(item.geometry))  # merges equal corners
        mesh.visual = trimesh.visual.ColorVisuals(mesh, face_colors=own)
        mesh.apply_transform(item.placement.homogeneous)
        found[item.parentJoint].append(mesh)
    return _joined(found)


@cache
def checked_meshes(model: RobotModel) -> Meshes:
    """Return the convex bodies that each joint of a robot moves."""
    found = defaultdict[int, list[trimesh.Trimesh]](list)
    for part in model.parts:
        hull = trimesh.convex.convex_hull(part.body.vertices)
        found[part.joint + 1].append(hull)
    return _joined(found)


def _joined(meshes: dict[int, list[trimesh.Trimesh]]) -> Meshes:
    """Return the meshes of each joint as one."""
    join: Callable[[list[trimesh.Trimesh]], Any] = trimesh.util.concatenate
    return {joint: join(own) for joint, own in meshes.items()}
