"""What MJCF leaves to its settings, written out where it counts: classes, angles and limits of joints.

pinocchio reads ranges of slides as angles, mixes classes, and knows neither ``autolimits: false`` nor
``limited: false`` nor the value that a joint has as it is drawn; so it is left nothing to choose.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from planning.errors import RobotModelError
from planning.robots.descriptions.xml_files import vector

_CLASSED = ("joint", "geom", "site", "mesh")
"""Elements with classes that count here."""

_TURNS = ("quat", "axisangle", "euler", "xyaxes", "zaxis")
"""Ways to say an orientation; an element has one of them."""

_KINDS = ("hinge", "slide", "ball", "free")

Classes = dict[str, dict[str, dict[str, str]]]
"""Attributes by class and kind of element, those of the classes around it among them."""


def write_settings_out(root: Element, path: Path) -> dict[str, float]:
    """Write the settings of a file, and those of its classes, into the elements that they are for.

    Sections that are there several times, as in files that include others, become one. Angles
    are in radians afterwards, turns are quaternions or axes, frames are bodies, and joints have a
    range where they are limited and only there.

    Args:
        root: of its XML, changed.
        path: the file, for messages.

    Returns:
        The values of joints as they are drawn, where these are not 0 [rad or m].

    Raises:
        RobotModelError: settings contradict each other, or are none.
    """
    _merge_sections(root)
    found = root.find("compiler")
    compiler = Element("compiler") if found is None else found
    settings = _Settings(compiler.attrib, path)
    classes: Classes = {"main": {}}
    for default in root.findall("default"):
        _collect(default, {}, classes, top=True)
        root.remove(default)
    for mesh in root.findall("asset/mesh"):
        _take_class(mesh, "main", classes)
    drawn: dict[str, float] = {}
    for world in root.findall("worldbody"):
        _settle(world, "main", classes, settings, drawn)
    compiler.attrib.pop("eulerseq", None)
    compiler.set("angle", "radian")
    if found is not None:
        root.remove(found)
    root.insert(0, compiler)  # whoever reads from top to bottom knows it in time
    return drawn


class _Settings:
    """What the compiler is told about angles and limits.

    Args:
        given: attributes of ``<compiler>``.
        path: the file, for messages.
    """

    def __init__(self, given: Mapping[str, str], path: Path) -> None:
        self.path = path
        angle = given.get("angle", "degree")
        if angle not in ("degree", "radian"):
            raise RobotModelError(
                f"{path}: angle of <compiler> is {angle!r}",
                choices=("degree", "radian"),
            )
        self.angle = 1.0 if angle == "radian" else math.pi / 180.0
        self.auto = given.get("autolimits", "true") == "true"
        self.sequence = given.get("eulerseq", "xyz")
        if len(self.sequence) != 3 or self.sequence.strip("xyzXYZ"):
            raise RobotModelError(
                f"{path}: eulerseq of <compiler> is {self.sequence!r}: must be three of x, y, z, X,"
                " Y and Z"
            )


def _merge_sections(root: Element) -> None:
    """Put the content of sections of a kind into the first of them."""
    first: dict[str, Element] = {}
    for section in list(root):
        kept = first.setdefault(section.tag, section)
        if kept is not section:
            kept.extend(list(section))
            kept.attrib.update(section.attrib)
            root.remove(section)


def _collect(
    default: Element,
    around: Mapping[str, Mapping[str, str]],
    classes: Classes,
    *,
    top: bool = False,
) -> None:
    """Write the attributes of a class, and of the classes within it, on top of those around it."""
    own = {tag: dict(values) for tag, values in around.items()}
    for child in default:
        if child.tag in _CLASSED:
            own[child.tag] = _on_top(own.get(child.tag, {}), child.attrib)
    name = default.get("class", "main")
    for key in (name, "main") if top else (name,):
        classes[key] = own
    for child in default.findall("default"):
        _collect(child, own, classes)


def _on_top(low: Mapping[str, str], high: Mapping[str, str]) -> dict[str, str]:
    """Return attributes with others on top; whoever says an orientation says all of it."""
    turned = any(key in high for key in _TURNS)
    kept = {k: v for k, v in low.items() if not (turned and k in _TURNS)}
    return kept | dict(high)


def _take_class(element: Element, around: str, classes: Classes) -> None:
    """Give an element what its class says; ``around`` is the class of all that name none."""
    name = element.attrib.pop("class", around)
    low = classes.get(name, {}).get(element.tag, {})
    whole = _on_top(low, element.attrib)
    element.attrib.clear()
    element.attrib.update(whole)


def _settle(
    body: Element,
    around: str,
    classes: Classes,
    settings: _Settings,
    drawn: dict[str, float],
) -> None:
    """Write settings into all that is in a body."""
    around = body.attrib.pop("childclass", around)
    joints = 0
    for number, child in enumerate(body):
        if child.tag in _CLASSED:
            _take_class(child, around, classes)
        _turn(child, settings)
        if child.tag == "joint":
            child.attrib.setdefault("name", f"{body.get('name', '')}Joint_{joints}")
            joints += 1
            _limit(child, settings, drawn)
        if child.tag == "frame":
            if child.find("joint") is not None:
                raise RobotModelError(
                    f"{settings.path}: a <frame> of body {body.get('name')!r} has a joint; put the"
                    " joint into the body"
                )
            child.tag = "body"
            child.set("name", f"{body.get('name', 'world')}.frame{number}")
        if child.tag == "body":
            _settle(child, around, classes, settings, drawn)


def _turn(element: Element, settings: _Settings) -> None:
    """Say an orientation that is given by angles as a quaternion."""
    where = f"of <{element.tag}> {element.get('name', '')!r}"
    if (text := element.attrib.pop("euler", None)) is not None:
        turned = Rotation.identity()
        angles = vector(text, f"{settings.path}: euler {where}")
        for axis, angle in zip(settings.sequence, angles, strict=True):
            step = Rotation.from_euler(axis.lower(), angle * settings.angle)
            # Small letters turn with the frame, capital ones do not.
            turned = turned * step if axis.islower() else step * turned
    elif (text := element.attrib.pop("axisangle", None)) is not None:
        *along, angle = vector(text, f"{settings.path}: axisangle {where}", 4)
        length = float(np.linalg.norm(along))
        if length == 0.0:
            raise RobotModelError(
                f"{settings.path}: axisangle {where} has no axis: {text!r}"
            )
        turned = Rotation.from_rotvec(
            np.array(along) * (angle * settings.angle / length)
        )
    else:
        return
    x, y, z, w = turned.as_quat()
    element.set("quat", f"{float(w)!r} {float(x)!r} {float(y)!r} {float(z)!r}")


def _limit(joint: Element, settings: _Settings, drawn: dict[str, float]) -> None:
    """Write the range of a joint in radians or metres, if it has one, and keep its drawn value."""
    name, kind = joint.get("name", ""), joint.get("type", "hinge")
    where = f"{settings.path}: joint {name!r}"
    if kind not in _KINDS:
        raise RobotModelError(f"{where} is of type {kind!r}", choices=_KINDS)
    # Only these turn: what slides is in metres, whatever angles are in.
    unit = settings.angle if kind in ("hinge", "ball") else 1.0
    value = vector(joint.attrib.pop("ref", "0"), f"{where}, ref", 1)[0] * unit
    if value and kind in ("hinge", "slide"):
        drawn[name] = value
    limited = joint.attrib.pop("limited", "auto")
    text = joint.attrib.pop("range", None)
    if limited == "auto" and text is not None and not settings.auto:
        raise RobotModelError(
            f'{where} has a range, and with autolimits="false" nothing says whether it is limited;'
            ' give it limited="true" or limited="false"'
        )
    if limited == "true" or (limited == "auto" and text is not None):
        low, high = vector(text or "", f"{where} is limited: its range", 2)
        if kind in ("hinge", "slide"):
            if low >= high:
                raise RobotModelError(
                    f"{where} is limited: its range must rise, is {text!r}"
                )
            joint.set("range", f"{low * unit!r} {high * unit!r}")
