"""Visual shapes of a robot, one mesh for each joint that moves them, and their poses at a configuration."""

from __future__ import annotations

import math
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import trimesh

from planning.cell.workcell import PlacedRobot
from planning.robots.registry import ROBOTS
from planning.transforms import Array
from twin.drawing.looks import painted_description
from twin.drawing.team_colours import parse_rgb


class RobotFigure:
    """Visual shapes of a robot.

    Args:
        robot: the robot.
        colour: colour of the robot, #rrggbb.

    Attributes:
        base: pose of its base in the world.
        meshes: coloured mesh of all shapes that one joint moves, by the number of the joint; in its frame.
    """

    def __init__(self, robot: PlacedRobot, colour: str) -> None:
        self.base = robot.base
        self._joints = robot.model.joint_names
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "robot.urdf"
            painted_description(robot, parse_rgb(colour)).write(path)
            self._model = pin.buildModelFromUrdf(str(path))
            visuals = pin.buildGeomFromUrdf(
                self._model, str(path), pin.GeometryType.VISUAL
            )
        self._data = self._model.createData()
        self._rest = pin.neutral(self._model)
        entry = ROBOTS.get(robot.model.name)
        for name, value in (entry.frozen if entry else {}).items():
            self._set(self._rest, name, value)
        shapes: defaultdict[int, list[trimesh.Trimesh]] = defaultdict(list)
        for item in visuals.geometryObjects:
            shapes[item.parentJoint].append(_coloured_mesh(item))
        self.meshes = {joint: joined(own) for joint, own in shapes.items()}

    def poses(self, q: Array) -> dict[int, Array]:
        """Return the pose of each mesh in the world at a configuration, (4, 4) by number of its joint."""
        whole = self._rest.copy()
        for name, value in zip(self._joints, q.tolist(), strict=True):
            self._set(whole, name, value)
        pin.forwardKinematics(self._model, self._data, whole)
        placed = self._data.oMi
        return {k: self.base @ placed[k].homogeneous for k in self.meshes}

    def _set(self, whole: Array, joint: str, value: float) -> None:
        """Set a joint in a configuration of the description; a continuous one has cosine and sine."""
        if not self._model.existJointName(joint):
            return
        k = self._model.getJointId(joint)
        first = self._model.idx_qs[k]
        if self._model.nqs[k] == 2:
            whole[first : first + 2] = math.cos(value), math.sin(value)
        else:
            whole[first] = value


def joined(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Return meshes as one."""
    found = trimesh.util.concatenate(meshes)
    assert isinstance(found, trimesh.Trimesh)
    return found


def _coloured_mesh(item: pin.GeometryObject) -> trimesh.Trimesh:
    """Return the mesh of a visual shape in the frame of its joint, in its colour."""
    mesh = _mesh(item)
    mesh.apply_transform(item.placement.homogeneous)
    colour = np.round(255 * np.clip(item.meshColor, 0.0, 1.0)).astype(np.uint8)
    mesh.visual = trimesh.visual.ColorVisuals(
        mesh, face_colors=np.tile(colour, (len(mesh.faces), 1))
    )
    return mesh


def _mesh(item: pin.GeometryObject) -> trimesh.Trimesh:
    shape: Any = item.geometry
    found: trimesh.Trimesh
    if isinstance(shape, coal.Box):
        found = trimesh.creation.box(2.0 * shape.halfSide)
    elif isinstance(shape, coal.Cylinder):
        found = trimesh.creation.cylinder(shape.radius, 2.0 * shape.halfLength)
    elif isinstance(shape, coal.Sphere):
        found = trimesh.creation.icosphere(3, shape.radius)
    elif isinstance(shape, coal.Capsule):
        found = trimesh.creation.capsule(2.0 * shape.halfLength, shape.radius)
    else:
        corners = map(shape.tri_indices, range(shape.num_tris))
        faces = np.array([(own[0], own[1], own[2]) for own in corners])
        found = trimesh.Trimesh(shape.vertices(), faces)  # merges equal corners
    return found
