"""Reads the description of a robot or a tool, whatever it is written in, as URDF."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from planning.errors import RobotModelError
from planning.files import read_file
from planning.robots.descriptions.mesh_files import find_mesh, search_folders
from planning.robots.descriptions.xml_reading import read_xml


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
    return root


def is_plain_urdf(path: Path) -> bool:
    """Tell whether every program reads a description as it is, its meshes where it names them."""
    root = read_xml(path)
    try:
        ElementTree.fromstring(read_file(path))
    except ElementTree.ParseError:  # prefixes that stand for nothing
        return False
    dirs = search_folders(path)
    return root.tag == "robot" and all(
        find_mesh(mesh.get("filename", ""), dirs) is not None
        for mesh in root.findall("link/collision//mesh")
    )
