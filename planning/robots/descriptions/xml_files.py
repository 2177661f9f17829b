"""Robot descriptions as XML files: lenient reading, mesh search, checks of numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from planning.errors import RobotModelError
from planning.files import is_file, read_file, ros_folders

# Some files have comments before their XML declaration.
_DECLARATION = re.compile(rb"\A((?:\s+|<!--.*?-->)+)<\?xml[^>]*\?>", re.DOTALL)

_DEEPEST = 100
"""Greatest depth of elements in elements."""

_ABOVE = 6
"""Number of parent folders of a description in which meshes are searched."""

# What a link may measure and how far from its joint it may be [m], [rad]: libraries crash,
# or never end, on bodies of 1e300 m and of no size at all.
SIZES = {
    "size": (1e-6, 1000.0, 3),
    "radius": (1e-6, 1000.0, 1),
    "length": (1e-6, 1000.0, 1),
    "scale": (1e-9, 1e6, 3),
}
SHAPES = {
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "mesh": ("filename",),
}
"""Shapes of URDF, each with its required attributes."""

_PLACES = {"xyz": (0.0, 1000.0, 3), "rpy": (0.0, 1e4, 3)}


def read_xml(path: Path) -> Element:
    """Return the root of an XML file, with name prefixes kept.

    Files of vendors name elements such as ``drake:member`` and attributes such as
    ``drake:acceleration`` without saying what the prefix stands for.

    Raises:
        RobotModelError: the file is missing, cannot be read, or is not XML.
    """
    if not is_file(path):
        raise RobotModelError(f"robot description {path} does not exist")
    try:
        content = read_file(path)
    except OSError as error:
        raise RobotModelError(f"{path} cannot be read: {error.strerror}") from None
    return parse_xml(content, path)


def parse_xml(content: bytes, path: Path) -> Element:
    """Return the root of XML, with name prefixes kept; ``path`` is for messages."""
    builder, parser, depth = TreeBuilder(), expat.ParserCreate(), 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > _DEEPEST:
            raise ValueError(f"elements are nested more than {_DEEPEST} deep")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    parser.buffer_text = True
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    try:
        # Some files end with a zero byte.
        content = content.rstrip(b"\0 \t\r\n")
        parser.Parse(_DECLARATION.sub(rb"\1", content, count=1), True)
        return builder.close()
    except (expat.ExpatError, ValueError, LookupError, AssertionError) as error:
        raise RobotModelError(f"{path} is not XML: {error}") from None


def strip_prefixes(root: Element) -> None:
    """Remove elements and attributes with a prefix, which are annotations of other programs."""
    for element in list(root.iter()):
        for child in list(element):
            if ":" in child.tag:
                element.remove(child)
        for key in [key for key in element.attrib if ":" in key]:
            del element.attrib[key]


def search_folders(path: Path, package_dirs: Sequence[Path] = ()) -> tuple[Path, ...]:
    """Return the search path for the meshes of a description, its own folder first.

    Where ROS is set up, its packages are searched too.
    """
    above = list(path.resolve().parents)[1 : _ABOVE + 1]
    return tuple(dict.fromkeys((path.parent, *package_dirs, *above, *ros_folders())))


def find_mesh(name: str, dirs: Sequence[Path]) -> Path | None:
    """Return the first file that matches a mesh's name, None where there is none."""
    bare = _bare_name(name)
    places = (folder / bare for folder in dirs)  # an absolute path stays as it is
    return next((place for place in places if is_file(place)), None)


def find_mesh_of_package(name: str, dirs: Sequence[Path]) -> Path | None:
    """Return the matching mesh file where the folder of its package has another name.

    A package that was downloaded is often in a folder such as ``arm_description-main``.
    """
    found = find_mesh(name, dirs)
    if found is None and name.startswith(("package://", "model://")):
        found = find_mesh(_bare_name(name).partition("/")[2], dirs)
    return found


def _bare_name(name: str) -> str:
    """Return the name of a mesh without its scheme."""
    for scheme in ("file://", "package://", "model://"):
        name = name.removeprefix(scheme)
    return name


def check_numbers(root: Element, path: Path) -> None:
    """Check that the numbers of the geometry are valid and plausible in magnitude."""
    for joint in root.findall("joint"):
        where = f"{path}: joint {joint.get('name')!r}"
        # Also of a second one, though only the first counts.
        for element in (*joint.findall("origin"), *joint.findall("axis")):
            _check_values(element, _PLACES, where)
    for link in root.findall("link"):
        where = f"{path}: link {link.get('name')!r}"
        for body in link.findall("collision"):
            for origin in body.findall("origin"):
                _check_values(origin, _PLACES, where)
            for shape in body.findall("geometry/*"):
                _require_keys(shape, where)
                _check_values(shape, SIZES, where)


def check_meshes(root: Element, path: Path, dirs: Sequence[Path]) -> None:
    """Check that the mesh of every collision shape exists."""
    for link in root.findall("link"):
        for element in link.findall("collision//mesh"):
            name = required_attribute(element, "filename", path)
            if find_mesh_of_package(name, dirs) is None:
                raise RobotModelError(
                    f"{path}: link {link.get('name')!r}: mesh {name!r} was not found in "
                    + ", ".join(str(place) for place in dict.fromkeys(dirs))
                )


def _require_keys(shape: Element, where: str) -> None:
    if shape.tag not in SHAPES:
        raise RobotModelError(
            f"{where}: collision shape <{shape.tag}> is not supported",
            choices=tuple(SHAPES),
        )
    for key in SHAPES[shape.tag]:
        if not shape.get(key):
            raise RobotModelError(f"{where}: a <{shape.tag}> has no {key}")


def _check_values(
    element: Element,
    ranges: Mapping[str, tuple[float, float, int]],
    owner: str,
) -> None:
    for key in sorted(ranges.keys() & set(element.keys())):
        least, most, count = ranges[key]
        where, text = f"{owner}: {key} of a <{element.tag}>", element.get(key, "")
        for value in parse_vector(text, where, count):
            # A mirrored mesh has a negative scale.
            size = abs(value) if key in ("scale", "xyz", "rpy") else value
            if not least <= size <= most:
                raise RobotModelError(
                    f"{where} must be {least:g} to {most:g}, is {value:g}"
                )


def parse_number(text: str, where: str) -> float:
    """Return a number of a description; ``where`` locates it in messages."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RobotModelError(f"{where} must be a finite number, is {text!r}")
    return value


def parse_vector(text: str, where: str, count: int = 3) -> tuple[float, ...]:
    """Return a fixed number of values of a description."""
    values = tuple(parse_number(part, where) for part in text.split())
    if len(values) != count:
        raise RobotModelError(f"{where} must be {count} numbers, is {text[:60]!r}")
    return values


def required_attribute(element: Element, key: str, path: Path) -> str:
    """Return a required attribute of an element."""
    value = element.get(key)
    if not value:
        raise RobotModelError(f"{path}: a <{element.tag}> has no {key}")
    return value
