"""Reads the description of a robot or a tool, whatever it is written in, as URDF."""

from __future__ import annotations

import copy
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from planning.errors import RobotModelError
from planning.files import read_file
from planning.robots.descriptions.held_joints import pose_of, write_pose
from planning.robots.descriptions.xml_files import (
    find_mesh,
    number,
    read_xml,
    search_folders,
)
from planning.transforms import translation


def read_description(path: Path) -> Element:
    """Return the description in a URDF or MJCF file as URDF, not checked yet.

    Raises:
        RobotModelError: the file cannot be read, or is neither.
    """
    root = read_xml(path)
    if root.tag == "mujoco":
        from planning.robots.descriptions.mjcf import urdf_of_mjcf

        return urdf_of_mjcf(root, path)
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
        for tag in ("collision", "visual"):
            for shape in link.findall(tag):
                capsule = shape.find("geometry/capsule")
                if capsule is not None and capsule.get("radius"):
                    where = f"{path}: link {link.get('name')!r}: a <capsule>"
                    _take_apart(link, shape, capsule, where)


def _take_apart(link: Element, shape: Element, capsule: Element, where: str) -> None:
    radius, length = capsule.get("radius", ""), capsule.get("length", "0")
    place = pose_of(shape.find("origin"), where)
    half = 0.5 * number(length, where)
    for kind, at in (("cylinder", 0.0), ("sphere", -half), ("sphere", half)):
        part = copy.deepcopy(shape)
        part.attrib.pop("name", None)
        geometry = part.find("geometry")
        assert geometry is not None
        geometry.clear()
        keys = (
            {"radius": radius, "length": length}
            if kind == "cylinder"
            else {"radius": radius}
        )
        SubElement(geometry, kind, keys)
        write_pose(part, place @ translation(0.0, 0.0, at))
        link.append(part)
    link.remove(shape)


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
