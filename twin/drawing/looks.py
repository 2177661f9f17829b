"""Colours of robots and fixtures in drawings.

Each robot has one colour. Fixtures have the colour of their description, or grey.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator
from xml.etree import ElementTree

import numpy as np

from planning.cell.workcell import Fixture, PlacedRobot, Workcell
from planning.robots.descriptions.xml_files import find_mesh
from planning.transforms import Array

_PAINTED = 0.6
"""Least colour saturation of the robot parts that are repainted in the robot's colour."""

_LIGHT = 0.75
"""Meshes with all channels as light as this are tinted by it."""

_TINT = 0.55
"""Share of the team's colour in the tint."""

_WHITE = (1.0, 1.0, 1.0)
_GREYS = ((178, 170, 158), (196, 201, 207), (140, 146, 154))


def paint_robot(
    urdf: ElementTree.Element, colour: tuple[int, int, int], *, linear: bool = False
) -> None:
    """Paint a robot: coloured parts are recoloured, white meshes tinted.

    Parts that are grey or black stay as they are.

    Args:
        urdf: root of the description, changed in place.
        colour: red, green and blue, 0 to 255.
        linear: write linear intensities, as some viewers expect.
    """

    def rgba(channels: Iterable[float]) -> str:
        shades = [round(channel, 4) for channel in channels]
        return " ".join(f"{_linear(c) if linear else c:.4f}" for c in shades) + " 1"

    coats = {
        material.get("name"): channels
        for material in urdf.iter("material")
        if (channels := _channels(material)) is not None
    }
    full = rgba(c / 255.0 for c in colour)
    tint = rgba(1.0 - _TINT * (1.0 - c / 255.0) for c in colour)
    for visual in urdf.iter("visual"):
        material = visual.find("material")
        own = None if material is None else _channels(material)
        if own is None and material is not None:
            own = coats.get(material.get("name"))
        if own is not None and _saturation(own) >= _PAINTED:
            _coat(visual, "team", full)
        elif visual.find("geometry/mesh") is not None and min(own or _WHITE) >= _LIGHT:
            _coat(visual, "team-tint", tint)


def _linear(channel: float) -> float:
    """Return the linear intensity of an sRGB channel, 0 to 1."""
    return channel / 12.92 if channel <= 0.04045 else ((channel + 0.055) / 1.055) ** 2.4


def _coat(visual: ElementTree.Element, name: str, rgba: str) -> None:
    for material in visual.findall("material"):
        visual.remove(material)
    coat = ElementTree.SubElement(visual, "material", name=name)
    ElementTree.SubElement(coat, "color", rgba=rgba)


def _channels(material: ElementTree.Element) -> tuple[float, ...] | None:
    """Return the colour of a material, red, green and blue from 0 to 1."""
    coat = material.find("color")
    try:
        return (
            None
            if coat is None
            else tuple(map(float, coat.get("rgba", "").split()))[:3]
        )
    except ValueError:
        return None


def _saturation(channels: tuple[float, ...]) -> float:
    """Return the saturation of a colour, 0 to 1; nearly black counts as grey."""
    bright = max(channels, default=0.0)
    return (bright - min(channels)) / bright if bright > 0.2 else 0.0


def foot_position(robot: PlacedRobot) -> Array:
    """Return the origin of a robot's base; of its first joint where others have that base, shape (3,) [m]."""
    foot = robot.base
    if robot.mounted_on:
        foot = foot @ robot.model.chain.placement[0]
    return np.asarray(foot[:3, 3])


def coloured_fixtures(
    cell: Workcell,
) -> Iterator[tuple[Fixture, tuple[int, int, int]]]:
    """Yield the fixtures of a cell with their colours, 0 to 255: their own, or greys.

    Links of robots are drawn with the first of these.
    """
    ground, *others = _GREYS
    links = {item for robot in cell.robots for item in robot.mounted_on}
    for k, fixture in enumerate(cell.fixtures):
        # The first one, mostly the table, differs from all that stand on it.
        grey = ground if k == 0 else others[(k - 1) % len(others)]
        if fixture in links:
            continue
        yield fixture, fixture.colour or grey


def painted_description(
    robot: PlacedRobot, colour: tuple[int, int, int], *, linear: bool = False
) -> ElementTree.ElementTree[ElementTree.Element]:
    """Return a URDF in the robot's colour, every mesh path absolute: package roots differ.

    Args:
        robot: the robot.
        colour: red, green and blue, 0 to 255.
        linear: see paint.
    """
    tree = ElementTree.parse(robot.model.urdf)
    for mesh in tree.getroot().iter("mesh"):
        found = find_mesh(mesh.get("filename", ""), robot.model.package_dirs)
        if found is not None:
            mesh.set("filename", str(found.resolve()))
    _show_hidden(robot, tree.getroot())
    paint_robot(tree.getroot(), colour, linear=linear)
    return tree


def _show_hidden(robot: PlacedRobot, root: ElementTree.Element) -> None:
    """Show the collision shapes of an arm or tool without visual shapes."""
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
