"""A URDF rewritten so that Bullet measures every collision shape exactly.

Bullet puts the shapes of a link in one compound, whose children keep a margin of 1 mm that
cannot be taken away. A shape that is alone in its link, at the link's origin, is not put in a
compound: boxes, cylinders and spheres then have sharp faces once their margin is set to zero.
Nothing else of the description changes.
"""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from planning.errors import RobotModelError


@dataclass(frozen=True)
class ShapeLink:
    """A link that carries one collision shape.

    Attributes:
        link: name of the new link.
        owner: link of the original description that the shape belongs to.
        mesh: True when the shape is the hull of a mesh.
    """

    link: str
    owner: str
    mesh: bool


def one_shape_a_link(
    urdf: Path, package_dirs: Sequence[Path]
) -> tuple[str, tuple[ShapeLink, ...]]:
    """Return the rewritten description and the links that carry its shapes.

    Every collision shape becomes a link of its own, fixed to the link it came from. Visual
    shapes and inertias are left out: the audit looks at positions only.

    Args:
        urdf: the description.
        package_dirs: where meshes are looked up, after the description's folder.

    Raises:
        RobotModelError: the file cannot be read, or a mesh is not there.
    """
    try:
        robot = ElementTree.parse(urdf).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise RobotModelError(f"cannot read {urdf}: {error}") from error
    shapes: list[ShapeLink] = []
    for link in robot.findall("link"):
        owner = str(link.get("name"))
        collisions = link.findall("collision")
        for child in list(link):
            link.remove(child)
        link.append(_unit_inertia())
        for number, collision in enumerate(collisions):
            mesh = collision.find("geometry/mesh")
            if mesh is not None:
                mesh.set("filename", _mesh_file(mesh, urdf, package_dirs))
            name = f"{owner}//{number}"
            shapes.append(ShapeLink(name, owner, mesh is not None))
            robot.append(_shape_link(name, collision))
            robot.append(_mount(name, owner, collision.find("origin")))
    return ElementTree.tostring(robot, encoding="unicode"), tuple(shapes)


def _shape_link(name: str, collision: ElementTree.Element) -> ElementTree.Element:
    link = ElementTree.Element("link", name=name)
    link.append(_unit_inertia())
    at_origin = ElementTree.SubElement(link, "collision")
    geometry = collision.find("geometry")
    if geometry is not None:
        at_origin.append(copy.deepcopy(geometry))
    return link


def _mount(
    name: str, owner: str, origin: ElementTree.Element | None
) -> ElementTree.Element:
    joint = ElementTree.Element("joint", name=f"{name}//mount", type="fixed")
    ElementTree.SubElement(joint, "parent", link=owner)
    ElementTree.SubElement(joint, "child", link=name)
    if origin is not None:
        joint.append(copy.deepcopy(origin))
    return joint


def _unit_inertia() -> ElementTree.Element:
    """Return an inertia at the link's origin: Bullet's link frame is then the URDF's."""
    inertial = ElementTree.Element("inertial")
    ElementTree.SubElement(inertial, "mass", value="1")
    ones = {"ixx": "1", "iyy": "1", "izz": "1", "ixy": "0", "ixz": "0", "iyz": "0"}
    ElementTree.SubElement(inertial, "inertia", ones)
    return inertial


def _mesh_file(
    mesh: ElementTree.Element, urdf: Path, package_dirs: Sequence[Path]
) -> str:
    name = str(mesh.get("filename"))
    bare = name.removeprefix("file://").removeprefix("package://")
    folders = [urdf.parent, *package_dirs]
    for folder in folders:
        if (folder / bare).is_file():
            return str((folder / bare).resolve())
    raise RobotModelError(
        f"{urdf}: mesh {name!r} was not found", choices=tuple(str(f) for f in folders)
    )
