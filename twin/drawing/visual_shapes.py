"""Visual shapes of robots, read by pinocchio: which joint moves each of them, and their triangles."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio

from planning.cell.shape import Box, Capsule, Cylinder, Form
from planning.cell.workcell import PlacedRobot
from planning.robots.descriptions.fitting import written_options
from planning.robots.registry import ROBOTS
from planning.transforms import Array, Indices
from twin.drawing.triangles import corners_of


def read_visual_shapes(
    description: ElementTree.Element, robot: PlacedRobot
) -> tuple[Any, Any]:
    """Return kinematic model and visual geometry of a URDF, reduced to the moved joints.

    Shapes of which the mesh file is missing are left out of both and of the description.

    Args:
        description: with absolute paths of meshes.
        robot: whose joints are moved; all others are held.
    """
    _leave_out_lost(description)
    text = ElementTree.tostring(description, encoding="unicode")
    model = pinocchio.buildModelFromXML(text)
    kind = pinocchio.GeometryType.VISUAL
    shown = pinocchio.buildGeomFromUrdfString(model, text, kind)
    moved = set(robot.model.joint_names)
    others = [name for name in model.names[1:] if name not in moved]
    if others:
        known = written_options(description) or ROBOTS.get(robot.model.name)
        held = known.frozen if known else {}
        still = pinocchio.neutral(model)
        for name in held.keys() & set(others):
            still[model.joints[model.getJointId(name)].idx_q] = held[name]
        ids = [model.getJointId(name) for name in others]
        model, shown = pinocchio.buildReducedModel(model, shown, ids, still)
    return model, shown


def shape_triangles(shape: Any) -> tuple[Array, Indices]:
    """Return vertices, shape (v, 3) [m], and triangles, shape (f, 3), of a shape of coal."""
    kind = type(shape).__name__
    if kind == "Box":
        form: Form = Box(tuple((2.0 * np.asarray(shape.halfSide)).tolist()))
    elif kind in ("Cylinder", "Capsule", "Sphere"):
        length = 2.0 * float(getattr(shape, "halfLength", 0.0))
        turned = Cylinder if kind == "Cylinder" else Capsule
        form = turned(float(shape.radius), length)
    else:
        faces = [shape.tri_indices(k) for k in range(shape.num_tris)]
        return shape.vertices(), np.array([[f[0], f[1], f[2]] for f in faces])
    corners = corners_of(form)
    return corners, np.arange(len(corners)).reshape(-1, 3)


def _leave_out_lost(root: ElementTree.Element) -> None:
    """Remove bodies whose mesh file is missing."""
    for link in root.findall("link"):
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is not None and not Path(mesh.get("filename", "")).is_file():
                link.remove(visual)
