"""The mass that a tool is said to have, in its description: in place of what its links add up to."""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement

from planning.robots.descriptions.xml_files import number
from planning.transforms import Array

_TURNING = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")

_SHORTEST = 0.01
"""No tool is shorter than this [m]."""


def weigh(body: Element, link: str, mass: float, centre: Array, length: float) -> None:
    """Let the links of a description weigh so much together.

    Links that have masses keep their shares of it. Where none has, all of it is in one link, and
    turns as a rod does across its axis.

    Args:
        body: of a URDF, changed.
        link: name of the one that has the mass where none is told.
        mass: of all [kg].
        centre: where that one has it, in the frame of the link, shape (3,) [m].
        length: of the rod [m].

    Raises:
        RobotModelError: a mass of the description is no number.
    """
    told = [
        (mass, mass.get("value", "0")) for mass in body.findall("link/inertial/mass")
    ]
    masses = [number(value, "mass of a link") for _, value in told]
    if sum(masses) > 0.0:
        share = mass / sum(masses)
        for (element, _), own in zip(told, masses, strict=True):
            element.set("value", repr(own * share))
        for inertia in body.findall("link/inertial/inertia"):
            for key in _TURNING:
                own = number(inertia.get(key, "0"), "inertia of a link")
                inertia.set(key, repr(own * share))
        return
    for element in body.findall("link"):
        for empty in element.findall("inertial"):
            element.remove(empty)
        if element.get("name") == link:
            turning = mass * max(length, _SHORTEST) ** 2 / 12.0
            inertial = SubElement(element, "inertial")
            SubElement(inertial, "origin", xyz=" ".join(map(repr, centre.tolist())))
            SubElement(inertial, "mass", value=repr(mass))
            same = {key: repr(turning if key[1] == key[2] else 0.0) for key in _TURNING}
            SubElement(inertial, "inertia", same)
