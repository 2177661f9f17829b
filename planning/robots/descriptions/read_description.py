"""Reads the description of a robot or a tool, whatever it is written in, as URDF.

Joints of a description that are held at values: they become fixed, and what mimics them too.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from planning.errors import RobotModelError
from planning.files import read_file
from planning.robots.descriptions.mjcf import urdf_of_mjcf
from planning.robots.descriptions.xml_files import (
    TURNING,
    find_mesh,
    joint_motion,
    number,
    pose_of,
    read_xml,
    search_folders,
    write_pose,
)
from planning.transforms import translation

_SLACK = 1e-6
"""A value may be past a limit by this: rounding of files [rad or m]."""


def hold_joints(root: Element, path: Path, values: Mapping[str, float]) -> None:
    """Fix joints where they are held, and all that mimic one of them.

    Args:
        root: of a URDF, changed.
        path: its file, for messages.
        values: joint names and values [rad or m]; what mimics one of them may be named too.

    Raises:
        RobotModelError: there is no such joint, it cannot be held, or a value is past its limits.
    """
    joints = {str(joint.get("name")): joint for joint in root.findall("joint")}
    for name, value in values.items():
        if name not in joints or joints[name].get("type") == "fixed":
            choices = free_joints(root)
            raise RobotModelError(
                f"{path} has no joint {name!r} to hold"
                + ("" if choices else ": it has none that moves"),
                choices=choices,
            )
        _require_within(joints[name], value, f"{path}: joint {name!r}")
    for name, value in _with_followers(joints, values, path).items():
        _fix(joints[name], value, f"{path}: joint {name!r}")


def hold_all(root: Element, path: Path, values: Mapping[str, float]) -> None:
    """Fix all joints: those without a value at zero, or at the limit that is nearest to it."""
    held = dict(values)
    for joint in root.findall("joint"):
        name = str(joint.get("name"))
        if joint.get("type") == "fixed" or joint.find("mimic") is not None:
            continue
        lower, upper = _range(joint, f"{path}: joint {name!r}")
        held.setdefault(name, min(max(0.0, lower), upper))
    hold_joints(root, path, held)
    for name in free_joints(root):
        raise RobotModelError(
            f"{path}: joint {name!r} mimics a joint that is not there; name it among the joints that"
            " are held"
        )


def free_joints(root: Element) -> tuple[str, ...]:
    """Return the names of the joints that are not fixed."""
    return tuple(
        str(joint.get("name"))
        for joint in root.findall("joint")
        if joint.get("type") != "fixed"
    )


def free_kinds(root: Element) -> frozenset[str]:
    """Return the joints of kinds that cannot move here, but can be held at zero."""
    return frozenset(
        str(joint.get("name"))
        for joint in root.findall("joint")
        if joint.get("type") not in (*TURNING, "prismatic", "fixed")
    )


def _with_followers(
    joints: Mapping[str, Element], values: Mapping[str, float], path: Path
) -> dict[str, float]:
    """Return the values of the joints that are held and of those that mimic them."""

    def value_of(name: str, followed: tuple[str, ...]) -> float | None:
        if name in values:
            return values[name]
        mimic = joints[name].find("mimic") if name in joints else None
        if mimic is None or joints[name].get("type") == "fixed":
            return None
        if name in followed:
            raise RobotModelError(f"{path}: joint {name!r} mimics itself")
        where = f"{path}: joint {name!r}, <mimic>"
        factor = number(mimic.get("multiplier", "1"), f"{where} multiplier")
        offset = number(mimic.get("offset", "0"), f"{where} offset")
        leader = value_of(str(mimic.get("joint")), (*followed, name))
        return None if leader is None else factor * leader + offset

    found = {name: value_of(name, ()) for name in joints}
    return {name: value for name, value in found.items() if value is not None}


def _range(joint: Element, where: str) -> tuple[float, float]:
    limit = joint.find("limit")
    if limit is None or joint.get("type") == "continuous":
        return -math.inf, math.inf
    lower = number(limit.get("lower", "0"), f"{where}, lower limit")
    upper = number(limit.get("upper", "0"), f"{where}, upper limit")
    if lower > upper:
        raise RobotModelError(f"{where} has an empty range: {lower:g} to {upper:g}")
    return lower, upper


def _require_within(joint: Element, value: float, where: str) -> None:
    lower, upper = _range(joint, where)
    if lower == upper:
        return  # a range that was never filled in
    if not lower - _SLACK <= value <= upper + _SLACK:
        raise RobotModelError(
            f"{where} cannot be held at {value:g}: its limits are {lower:g} and {upper:g} (rad or m)"
        )


def _fix(joint: Element, value: float, where: str) -> None:
    kind = joint.get("type")
    pose = pose_of(joint.find("origin"), where)
    if kind in (*TURNING, "prismatic"):
        pose = pose @ joint_motion(joint, value, where)
    elif value != 0.0:
        raise RobotModelError(
            f"{where} is of type {kind!r}: it can be held at 0 only, not at {value:g}"
        )
    for child in list(joint):
        if child.tag not in ("parent", "child", "origin"):
            joint.remove(child)
    joint.set("type", "fixed")
    joint.set("held", repr(float(value)))  # for who reads it; programs pass over it
    if kind != "fixed" and not (value == 0.0 and joint.find("origin") is None):
        write_pose(joint, pose)


def read_description(path: Path) -> Element:
    """Return the description in a URDF or MJCF file as URDF, not checked yet.

    Raises:
        RobotModelError: the file cannot be read, or is neither.
    """
    root = read_xml(path)
    if root.tag == "mujoco":
        root = urdf_of_mjcf(root, path)
    if root.tag != "robot":
        raise RobotModelError(
            f"{path} is neither URDF nor MJCF: its root element is <{root.tag}>",
            choices=("robot", "mujoco"),
        )
    _take_capsules_apart(root, path)
    return root


def _take_capsules_apart(root: Element, path: Path) -> None:
    """Write capsules, which not every program reads, as a cylinder and two balls."""
    for link in root.findall("link"):
        for shape in (*link.findall("collision"), *link.findall("visual")):
            capsule = shape.find("geometry/capsule")
            if capsule is None or not capsule.get("radius"):
                continue
            where = f"{path}: link {link.get('name')!r}: a <capsule>"
            radius, length = capsule.get("radius", ""), capsule.get("length", "0")
            place = pose_of(shape.find("origin"), where)
            half = 0.5 * number(length, where)
            link.remove(shape)
            for kind, at in (("cylinder", 0.0), ("sphere", -half), ("sphere", half)):
                part = copy.deepcopy(shape)
                part.attrib.pop("name", None)
                geometry = part.find("geometry")
                assert geometry is not None
                geometry.clear()
                keys = {"radius": radius}
                if kind == "cylinder":
                    keys["length"] = length
                SubElement(geometry, kind, keys)
                write_pose(part, place @ translation(0.0, 0.0, at))
                link.append(part)


def is_plain_urdf(path: Path) -> bool:
    """Tell whether every program reads a description as it is, its meshes where it names them."""
    root = read_xml(path)
    try:
        ElementTree.fromstring(read_file(path))
    except ElementTree.ParseError:  # prefixes that stand for nothing
        return False
    dirs = search_folders(path)
    return (
        root.tag == "robot"
        and root.find("link/collision/geometry/capsule") is None
        and all(
            find_mesh(mesh.get("filename", ""), dirs) is not None
            for mesh in root.findall("link/collision//mesh")
        )
        # pinocchio wants these, whether they are of use or not.
        and all(
            {"effort", "velocity"} <= limit.attrib.keys()
            for limit in root.findall("joint/limit")
        )
        and all(
            inertial.find("mass") is not None and inertial.find("inertia") is not None
            for inertial in root.findall("link/inertial")
        )
    )
