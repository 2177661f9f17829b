"""The description of a robot as it is shown: in its colour, with nothing left out."""

from __future__ import annotations

import copy
from xml.etree import ElementTree

from planning.cell.workcell import PlacedRobot
from planning.robots.descriptions.xml_files import find_mesh
from twin.drawing.paint import paint


def painted_description(
    robot: PlacedRobot, colour: tuple[int, int, int]
) -> ElementTree.ElementTree[ElementTree.Element]:
    """Return a URDF in the robot's colour, every mesh path absolute: package roots differ.

    Args:
        robot: the robot.
        colour: red, green and blue, 0 to 255.
    """
    tree = ElementTree.parse(robot.model.urdf)
    for mesh in tree.getroot().iter("mesh"):
        found = find_mesh(mesh.get("filename", ""), robot.model.package_dirs)
        if found is not None:
            mesh.set("filename", str(found.resolve()))
    _show_hidden(robot, tree.getroot())
    paint(tree.getroot(), colour)
    return tree


def _show_hidden(robot: PlacedRobot, root: ElementTree.Element) -> None:
    """Have an arm or a tool of which a URDF shows nothing shown by what it collides with."""
    groups: dict[str, set[str]] = {}
    for part in robot.model.parts:
        groups.setdefault(part.group, set()).add(part.body.name.rpartition("_")[0])
    links = root.findall("link")
    for names in groups.values():
        own = [link for link in links if link.get("name") in names]
        if any(link.find("visual") is not None for link in own):
            continue
        for link in own:
            for collision in link.findall("collision"):
                shown = copy.deepcopy(collision)
                shown.tag = "visual"
                looks = ElementTree.SubElement(shown, "material", name="shown")
                ElementTree.SubElement(looks, "color", rgba="0.7 0.7 0.7 1")
                link.append(shown)
