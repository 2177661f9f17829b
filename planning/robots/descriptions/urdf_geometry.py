"""Poses and joint axes in a URDF: origins, axes, and poses of links in the frame of the root link."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Mapping
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from scipy.spatial.transform import Rotation

from planning.errors import RobotModelError
from planning.robots.descriptions.xml_files import parse_vector
from planning.transforms import Array, Transform, from_rpy

TURNING = ("revolute", "continuous")
"""Joint types that rotate; all other movable joints slide."""


def format_numbers(values: Iterable[float]) -> str:
    """Return numbers in URDF notation."""
    return " ".join(repr(float(value)) for value in values)


def origin_pose(element: Element | None, where: str) -> Transform:
    """Return the pose of an ``<origin>``; none means no offset."""
    if element is None:
        return np.eye(4)
    xyz = parse_vector(element.get("xyz", "0 0 0"), f"{where}, xyz of <origin>")
    rpy = parse_vector(element.get("rpy", "0 0 0"), f"{where}, rpy of <origin>")
    return from_rpy(xyz, rpy)


def write_pose(parent: Element, pose: Transform) -> None:
    """Replace the ``<origin>`` of an element."""
    for old in parent.findall("origin"):
        parent.remove(old)
    turned = np.asarray(pose)[:3, :3]
    level = np.array_equal(turned, np.eye(3))
    with warnings.catch_warnings(action="ignore"):  # where two angles say the same
        rpy = np.zeros(3) if level else Rotation.from_matrix(turned).as_euler("xyz")
    xyz = np.asarray(pose)[:3, 3]
    SubElement(parent, "origin", xyz=format_numbers(xyz), rpy=format_numbers(rpy))


def joint_axis(joint: Element, where: str) -> Array:
    """Return the unit axis of a joint in its own frame, shape (3,)."""
    element = joint.find("axis")
    text = "1 0 0" if element is None else element.get("xyz", "1 0 0")
    axis = np.array(parse_vector(text, f"{where}, axis"))
    length = math.hypot(*axis)
    if length == 0.0:
        raise RobotModelError(f"{where} has no direction: axis {text!r}")
    return axis / length


def joint_motion(joint: Element, value: float, where: str) -> Transform:
    """Return the transform of a revolute or prismatic joint at a value [rad or m]."""
    along, move = joint_axis(joint, where) * value, np.eye(4)
    if joint.get("type") in TURNING:
        move[:3, :3] = Rotation.from_rotvec(along).as_matrix()
    else:
        move[:3, 3] = along
    return move


def joint_link(joint: Element, tag: str) -> str:
    """Return the link at an end of a joint, ``parent`` or ``child``; empty where it names none."""
    end = joint.find(tag)
    return "" if end is None else str(end.get("link"))


def pose_in_root(
    link: str, above: Mapping[str, Element], values: Mapping[str, float], where: str
) -> Transform:
    """Return the pose of a link in the frame of the root of its description.

    Args:
        link: its name.
        above: the joint that each link hangs on.
        values: of the joints that are not at zero [rad or m].
        where: description, for messages.
    """
    pose = np.eye(4)
    while link in above:
        joint = above[link]
        name = str(joint.get("name"))
        if name in values:
            pose = joint_motion(joint, values[name], f"{where}: joint {name!r}") @ pose
        pose = origin_pose(joint.find("origin"), f"{where}: joint {name!r}") @ pose
        link = joint_link(joint, "parent")
    return pose
