"""Conversion of a URDF file to a RobotModel with pinocchio; collision shapes become convex hulls."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from itertools import combinations
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio

from planning.cell.body import Capsules, ConvexBody
from planning.cell.cover import capsule_covers, hull_vertices
from planning.cell.robot_model import (
    DriveLimits,
    KinematicChain,
    LinkInertias,
    LinkPart,
    RobotModel,
)
from planning.errors import RobotModelError
from planning.robots.descriptions.fitting import written_options
from planning.robots.descriptions.urdf_file import (
    UrdfFile,
    UrdfOptions,
    flange_link,
    links_on_flange,
    serial_chain,
    tip_link,
)
from planning.robots.descriptions.xml_files import parse_number, read_xml
from planning.robots.self_collision import never_colliding_pairs
from planning.transforms import Array, inverse, read_only_copy

_SIDES = 24
"""Number of side faces of a prism around a cylinder: its corners exceed the radius by 0.9 %."""


def load_urdf(
    path: Path,
    options: UrdfOptions = UrdfOptions(),  # noqa: B008 - frozen
    *,
    package_dirs: tuple[Path, ...] = (),
) -> RobotModel:
    """Read a serial arm.

    Fixed joints are merged into the moved joint above them. A mesh becomes its convex hull,
    cylinders and spheres polyhedra around them; each hull gets a cover of capsules.

    Args:
        path: URDF file.
        options: HOME, flange, tool, and what else the file does not say.
        package_dirs: where meshes are looked up, after the file's folder and its parents.

    Raises:
        RobotModelError: the description cannot be used.
    """
    path = Path(path)
    root = read_xml(path)
    known = written_options(root) or options
    description = serial_chain(root, path, package_dirs, frozenset(known.frozen))
    model, geometry = _build(description, known.frozen)
    flange_name = flange_link(description, known.flange_link)
    flange = _link_pose(model, flange_name) @ known.flange_offset
    hanging = known.tool_links
    if hanging is None:
        hanging = links_on_flange(description, flange_name)
    frames = known.frames
    if frames is None:
        there = tuple(link for link in hanging if model.existFrame(link))
        tip = tip_link(there) or (there[-1] if there else flange_name)
        frames = {"tool": inverse(flange) @ _link_pose(model, tip)}
    joints = description.joints
    lower = read_only_copy([joint.lower for joint in joints])
    upper = read_only_copy([joint.upper for joint in joints])
    chain = _chain(description, model)
    _require_all_shapes(root, geometry, path)
    parts = _parts(model, geometry, set(hanging), path)
    ignored = frozenset(known.ignored)
    home = np.zeros(len(lower)) if known.home is None else known.home
    if len(home) != len(lower):
        raise RobotModelError(
            f"{path} has {len(lower)} joints that move, and {len(home)} values of HOME"
        )
    rest = np.clip(home, lower, upper)
    speeds = known.velocity or [joint.velocity for joint in joints]
    return RobotModel(
        name=known.name or path.stem,
        urdf=path,
        package_dirs=description.package_dirs,
        joint_names=tuple(joint.name for joint in joints),
        lower=lower,
        upper=upper,
        velocity=read_only_copy(speeds),
        chain=chain,
        flange=read_only_copy(flange),
        frames={key: read_only_copy(pose) for key, pose in frames.items()},
        parts=parts,
        never_collide=never_colliding_pairs(chain, parts, lower, upper, rest)
        | {
            (i, j)
            for (i, a), (j, b) in combinations(enumerate(parts), 2)
            if not ignored.isdisjoint({(a.link, b.link), (b.link, a.link)})
        },
        home=read_only_copy(rest),
        flange_link=flange_name,
        grip=known.grip,
        drives=_drives(root, description, known, set(hanging)),
        inertias=_inertias(model),
        ignored_contacts=ignored,
    )


def _inertias(model: Any) -> LinkInertias:
    moved = list(model.inertias)[1:]
    return LinkInertias(
        read_only_copy([body.mass for body in moved]),
        read_only_copy([body.lever for body in moved]),
        read_only_copy([body.inertia for body in moved]),
    )


def _mass(root: Element, links: set[str]) -> float:
    """Return the mass of links, as far as a description states it [kg]."""
    return sum(
        parse_number(mass.get("value", "0"), "mass of a link")
        for link in root.findall("link")
        if link.get("name") in links
        and (mass := link.find("inertial/mass")) is not None
    )


def _drives(
    root: Element, description: UrdfFile, known: UrdfOptions, tool: set[str]
) -> DriveLimits:
    joints, payload = description.joints, known.payload
    return DriveLimits(
        acceleration=read_only_copy(
            known.acceleration or [joint.acceleration for joint in joints]
        ),
        jerk=read_only_copy(known.jerk or [joint.jerk for joint in joints]),
        effort=read_only_copy(known.effort or [joint.effort for joint in joints]),
        payload=math.inf if payload is None else payload,
        # It is not needed otherwise, and not every description has numeric masses.
        tool_mass=0.0 if payload is None else _mass(root, tool),
    )


def _build(description: UrdfFile, held: Mapping[str, float]) -> tuple[Any, Any]:
    dirs = [str(folder) for folder in description.package_dirs]
    path = str(description.path)
    try:
        model = pinocchio.buildModelFromUrdf(path)
        geometry = pinocchio.buildGeomFromUrdf(
            model, path, pinocchio.GeometryType.COLLISION, package_dirs=dirs
        )
    except (ValueError, RuntimeError) as error:
        raise RobotModelError(f"{description.path} cannot be read: {error}") from error
    if held:
        still = pinocchio.neutral(model)
        for name, value in held.items():
            still[model.joints[model.getJointId(name)].idx_q] = value
        ids = [model.getJointId(name) for name in held]
        model, geometry = pinocchio.buildReducedModel(model, geometry, ids, still)
    return model, geometry


def _chain(description: UrdfFile, model: Any) -> KinematicChain:
    """Return the chain, with placements from pinocchio (fixed joints merged) and axes from the file."""
    placement = [
        model.jointPlacements[model.getJointId(joint.name)].homogeneous
        for joint in description.joints
    ]
    prismatic = np.array([joint.kind == "prismatic" for joint in description.joints])
    prismatic.setflags(write=False)
    return KinematicChain(
        read_only_copy(placement),
        read_only_copy([j.axis for j in description.joints]),
        prismatic,
    )


def _require_all_shapes(root: Element, geometry: Any, path: Path) -> None:
    """Check that no collision shape is missing: the parser drops all of a link with an element that it cannot read."""
    found = Counter(item.name.rpartition("_")[0] for item in geometry.geometryObjects)
    for link in root.findall("link"):
        name = str(link.get("name"))
        if found[name] != len(link.findall("collision")):
            raise RobotModelError(
                f"{path}: link {name!r}: its <inertial>, a <visual> or a <collision> cannot be read"
            )


def _parts(
    model: Any, geometry: Any, tool: set[str], path: Path
) -> tuple[LinkPart, ...]:
    joints, groups, hulls = [], [], []
    for item in geometry.geometryObjects:
        local = shape_vertices(item.geometry, item.name)
        pose = item.placement.homogeneous
        hulls.append(read_only_copy(local @ pose[:3, :3].T + pose[:3, 3]))
        groups.append("tool" if model.frames[item.parentFrame].name in tool else "arm")
        joints.append(item.parentJoint - 1)
    if not hulls:
        raise RobotModelError(
            f"{path} has no collision geometry: no <collision> shapes"
        )
    covers: dict[int, Capsules] = {}
    # Tools work at close range: more capsules there spare exact decisions.
    for group, thrift in (("tool", 0.2), ("arm", 0.5)):
        own = [k for k, name in enumerate(groups) if name == group]
        found = capsule_covers([hulls[k] for k in own], thrift=thrift)
        covers.update(zip(own, found, strict=True))
    return tuple(
        LinkPart(joint, groups[k], ConvexBody(item.name, hulls[k], covers[k]))
        for k, (joint, item) in enumerate(
            zip(joints, geometry.geometryObjects, strict=True)
        )
    )


def _link_pose(model: Any, link: str) -> Array:
    frame = model.frames[model.getFrameId(link, pinocchio.FrameType.BODY)]
    return np.array(frame.placement.homogeneous)


def shape_vertices(shape: Any, name: str) -> Array:
    """Return corners whose hull contains a collision shape.

    Args:
        shape: coal geometry as pinocchio loads it: Box, Cylinder, Sphere, Capsule or a mesh.
        name: for messages.

    Returns:
        Shape (v, 3) in the shape's own frame [m].

    Raises:
        RobotModelError: the shape is of another kind, or a mesh without volume.
    """
    kind = type(shape).__name__
    if kind == "Box":
        half = np.asarray(shape.halfSide)
        signs = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
        return np.asarray(signs * half)
    if kind == "Cylinder":
        length = float(shape.halfLength)
        return frustum_corners(shape.radius, shape.radius, -length, length)
    if kind == "Sphere":
        return _sphere_corners(float(shape.radius))
    if kind == "Capsule":
        ends = [[0.0, 0.0, s * float(shape.halfLength)] for s in (-1.0, 1.0)]
        ball = _sphere_corners(float(shape.radius))
        return hull_vertices(np.vstack([ball + end for end in ends]))
    if hasattr(shape, "vertices"):
        points = np.asarray(shape.vertices(), dtype=np.float64)
        if len(points) < 4 or not np.all(np.isfinite(points)):
            raise RobotModelError(f"mesh of {name!r} has no volume")
        return hull_vertices(points)
    raise RobotModelError(
        f"collision shape {kind} of {name!r} is not supported",
        choices=("box", "cylinder", "sphere", "mesh"),
    )


def frustum_corners(
    radius_low: float, radius_high: float, low: float, high: float
) -> Array:
    """Return the corners of a prism around a cone frustum (or cylinder) along z.

    Args:
        radius_low, radius_high: radii at the two ends [m].
        low, high: z of the two ends [m].

    Returns:
        Shape (48, 3), the low ring first; every side face touches the cone.
    """
    angle = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    ring = np.column_stack([np.cos(angle), np.sin(angle)]) / np.cos(np.pi / _SIDES)
    return np.vstack(
        [
            np.column_stack([radius_low * ring, np.full(_SIDES, low)]),
            np.column_stack([radius_high * ring, np.full(_SIDES, high)]),
        ]
    )


def _sphere_corners(radius: float) -> Array:
    """Return the corners of a polyhedron around a sphere, shape (v, 3).

    A ring every ``pi / 24`` of latitude; the faces of such a net come no closer to the
    centre than ``cos(pi / 24) ** 2`` of its corners, by which the radius is enlarged.
    """
    latitude = np.linspace(-np.pi / 2, np.pi / 2, _SIDES + 1)
    longitude = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    lat, lon = (grid.ravel() for grid in np.meshgrid(latitude, longitude))
    unit = np.column_stack(
        [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    )
    return np.asarray(np.unique(radius / np.cos(np.pi / _SIDES) ** 2 * unit, axis=0))
