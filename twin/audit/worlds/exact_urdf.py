"""A URDF rewritten so that every collision shape is measured on its own, and exactly.

Every shape becomes a link of its own, so that distances are those of single convex shapes.

Bullet gives every shape of a URDF a margin of 1 mm that cannot be taken away. It inflates the
hulls of meshes by it, and rounds the edges of boxes and cylinders off with it. So for Bullet
boxes and cylinders are made larger by 1 mm here: what it then measures is the distance of the
sharp shape less 1 mm, for them as for hulls.
"""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from planning.errors import RobotModelError
from planning.robots.descriptions.xml_files import find_mesh


@dataclass(frozen=True)
class ShapeLink:
    """A link that carries one collision shape.

    Attributes:
        link: name of the new link.
        owner: link of the original description that the shape belongs to.
        margin: by how much it is measured too large [m].
    """

    link: str
    owner: str
    margin: float


def one_shape_a_link(
    urdf: Path, package_dirs: Sequence[Path], margin: float
) -> tuple[str, tuple[ShapeLink, ...]]:
    """Return the rewritten description and the links that carry its shapes.

    Every collision shape becomes a link of its own, fixed to the link it came from. Visual
    shapes and inertias are left out: the audit looks at positions only.

    Args:
        urdf: the description.
        package_dirs: where meshes are looked up.
        margin: that the collision library gives every shape [m].

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
            inflated = _prepare(collision, urdf, package_dirs, margin)
            name = f"{owner}//{number}"
            shapes.append(ShapeLink(name, owner, inflated))
            robot.append(_shape_link(name, collision))
            robot.append(_mount(name, owner, collision.find("origin")))
    # Bullet breaks lines of more than 8 kB, in the midst of a word.
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode"), tuple(shapes)


def _prepare(
    collision: ElementTree.Element,
    urdf: Path,
    package_dirs: Sequence[Path],
    margin: float,
) -> float:
    """Grow a shape by the margin or complete its file name; return how far it is inflated."""
    box = collision.find("geometry/box")
    if box is not None:
        size = [float(s) + 2 * margin for s in str(box.get("size")).split()]
        box.set("size", " ".join(map(repr, size)))
    cylinder = collision.find("geometry/cylinder")
    if cylinder is not None:
        cylinder.set("radius", repr(float(str(cylinder.get("radius"))) + margin))
        cylinder.set("length", repr(float(str(cylinder.get("length"))) + 2 * margin))
    mesh = collision.find("geometry/mesh")
    if mesh is not None:
        name = str(mesh.get("filename"))
        found = find_mesh(name, package_dirs)
        if found is None:
            choices = tuple(map(str, package_dirs))
            raise RobotModelError(
                f"{urdf}: mesh {name!r} was not found", choices=choices
            )
        mesh.set("filename", str(found.resolve()))
    # A sphere is a point with its radius for a margin: nothing to make up for.
    return 0.0 if collision.find("geometry/sphere") is not None else margin


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
