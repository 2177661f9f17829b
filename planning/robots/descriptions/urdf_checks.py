"""Checks of what a URDF says: numbers of a magnitude that bodies have, meshes that are there."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree.ElementTree import Element

from planning.errors import RobotModelError
from planning.robots.descriptions.mesh_files import find_mesh_of_package

# What a link may measure and how far from its joint it may be [m], [rad]: libraries crash,
# or never end, on bodies of 1e300 m and of no size at all.
_SIZES = {
    "size": (1e-6, 1000.0, 3),
    "radius": (1e-6, 1000.0, 1),
    "length": (1e-6, 1000.0, 1),
    "scale": (1e-9, 1e6, 3),
}
_PLACES = {"xyz": (0.0, 1000.0, 3), "rpy": (0.0, 1e4, 3)}

_SHAPES = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}
_SHAPES |= {"mesh": ("filename",)}


def check_numbers(root: Element, path: Path) -> None:
    """Require every number of the geometry to be one, and of a magnitude that bodies have."""
    for joint in root.findall("joint"):
        where = f"{path}: joint {joint.get('name')!r}"
        _check_values(joint.find("origin"), _PLACES, where)
        _check_values(joint.find("axis"), _PLACES, where)
    for link in root.findall("link"):
        where = f"{path}: link {link.get('name')!r}"
        for body in link.findall("collision"):
            _check_values(body.find("origin"), _PLACES, where)
            for shape in body.findall("geometry/*"):
                _require_keys(shape, where)
                _check_values(shape, _SIZES, where)


def check_meshes(root: Element, path: Path, dirs: Sequence[Path]) -> None:
    """Require the mesh of every collision shape to be there."""
    for link in root.findall("link"):
        for element in link.findall("collision//mesh"):
            name = attribute(element, "filename", path)
            if find_mesh_of_package(name, dirs) is None:
                raise RobotModelError(
                    f"{path}: link {link.get('name')!r}: mesh {name!r} was not found in "
                    + ", ".join(str(place) for place in dict.fromkeys(dirs))
                )


def _require_keys(shape: Element, where: str) -> None:
    if shape.tag not in _SHAPES:
        raise RobotModelError(
            f"{where}: collision shape <{shape.tag}> is not supported",
            choices=tuple(_SHAPES),
        )
    for key in _SHAPES[shape.tag]:
        if not shape.get(key):
            raise RobotModelError(f"{where}: a <{shape.tag}> has no {key}")


def _check_values(
    element: Element | None,
    ranges: Mapping[str, tuple[float, float, int]],
    owner: str,
) -> None:
    if element is None:
        return
    for key in sorted(ranges.keys() & set(element.keys())):
        least, most, count = ranges[key]
        where, text = f"{owner}: {key} of a <{element.tag}>", element.get(key, "")
        for value in vector(text, where, count):
            # A mirrored mesh has a negative scale.
            size = abs(value) if key in ("scale", "xyz", "rpy") else value
            if not least <= size <= most:
                raise RobotModelError(
                    f"{where} must be {least:g} to {most:g}, is {value:g}"
                )


def number(text: str, where: str) -> float:
    """Return a number of a description; ``where`` says which one, for messages."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RobotModelError(f"{where} must be a finite number, is {text!r}")
    return value


def vector(text: str, where: str, count: int = 3) -> tuple[float, ...]:
    """Return so many numbers of a description."""
    values = tuple(number(part, where) for part in text.split())
    if len(values) != count:
        raise RobotModelError(f"{where} must be {count} numbers, is {text[:60]!r}")
    return values


def attribute(element: Element, key: str, path: Path) -> str:
    """Return an attribute that an element must have."""
    value = element.get(key)
    if not value:
        raise RobotModelError(f"{path}: a <{element.tag}> has no {key}")
    return value
