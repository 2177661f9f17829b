"""Removal of collision shapes without volume from robot descriptions.

Some vendors describe a link without a body by a shape of size 0.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree.ElementTree import Element

from planning.errors import RobotModelError
from planning.files import read_file
from planning.robots.descriptions.description_files import MESH_BYTES
from planning.robots.descriptions.xml_files import (
    SHAPES,
    SIZES,
    find_mesh_of_package,
    parse_vector,
)

EMPTY = "empty"
"""Attribute of a link with the kinds of its collision shapes that have no volume and were left out."""

_STL_TEXT = re.compile(rb"solid\b[^\n\r\0]*([\n\r]+\s*endsolid\b[^\n\r\0]*)?\s*")
"""A text STL file that has no facet."""

_OBJ_LINE = re.compile(rb"(#.*|(v|vn|vt|vp|l|p|o|g|s|mtllib|usemtl)\b.*)?\s*")
"""A line of an OBJ file that defines no face."""


def remove_empty_shapes(root: Element, dirs: Sequence[Path]) -> None:
    """Remove shapes without volume, and record the kinds of colliding ones at their links."""
    for link, shape, form in find_empty_shapes(root, dirs):
        link.remove(shape)
        if shape.tag == "collision":
            link.set(EMPTY, f"{link.get(EMPTY, '')} {form.tag}".strip())


def find_empty_shapes(
    root: Element, dirs: Sequence[Path]
) -> list[tuple[Element, Element, Element]]:
    """Return link, collision or visual, and form (the shape if it has none) of each URDF shape without volume."""
    return [
        (link, shape, shape if form is None else form)
        for link in root.findall("link")
        for shape in (*link.findall("collision"), *link.findall("visual"))
        if (form := shape.find("geometry/*")) is None or _is_empty(form, dirs)
    ]


def _is_empty(form: Element, dirs: Sequence[Path]) -> bool:
    """Tell whether a size is 0 or a mesh has no triangles; invalid sizes are refused elsewhere."""
    if not all(form.get(key) for key in SHAPES.get(form.tag, ("",))):
        return False
    sizes: list[float] = []
    for key in SIZES.keys() & form.attrib.keys():
        least, most, count = SIZES[key]
        try:
            values = parse_vector(form.get(key, ""), key, count)
        except RobotModelError:
            return False
        sizes += [abs(v) if key == "scale" else v for v in values]
        if any(size != 0.0 and not least <= size <= most for size in sizes):
            return False
    if 0.0 in sizes or form.tag != "mesh":
        return 0.0 in sizes
    found = find_mesh_of_package(form.get("filename", ""), dirs)
    return found is not None and not _has_triangles(found)


def _has_triangles(path: Path) -> bool:
    """Tell whether an STL or OBJ file has a triangle; damaged or other formats count as having some."""
    try:
        content = read_file(path, MESH_BYTES)
    except OSError:
        return True
    kind, text = path.suffix.lower(), content.lstrip()
    if kind == ".stl":
        binary = len(content) == 84 and content[80:] == bytes(4)
        # The header of binary files, too, often begins with "solid".
        return not (binary or _STL_TEXT.fullmatch(text))
    if kind == ".obj":
        lines = re.split(rb"[\r\n]+\s*", text)
        return not text or any(not _OBJ_LINE.fullmatch(line) for line in lines)
    return True
