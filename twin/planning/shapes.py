"""Construction of collision shapes from the sections of a scenario."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from planning.cell.shape import (
    Box,
    Capsule,
    Cylinder,
    Element,
    Form,
    Shape,
    box_shape,
    shape_of,
)
from planning.errors import ShapeError
from planning.files import resolve_file_name
from planning.transforms import Transform, identity, read_only_copy
from twin.scenario.sections.shapes import ShapeSection


def build_shape(name: str, section: ShapeSection, folder: Path = Path()) -> Shape:
    """Return the shape that a section describes.

    Args:
        name: owner of the shape, for messages.
        section: section of the scenario.
        folder: where relative paths of meshes start.

    Raises:
        ShapeError: a mesh cannot be used; names it and a remedy.
    """
    if section.box is not None:
        return box_shape(name, section.box)
    return shape_of(name, tuple(_elements(section, read_only_copy(identity()), folder)))


def _elements(
    section: ShapeSection, pose: Transform, folder: Path
) -> Iterator[Element]:
    """Yield the collision primitives of a shape at a pose."""
    if section.compound is not None:
        for item in section.compound:
            place = read_only_copy(pose @ item.pose.transform())
            yield from _elements(item, place, folder)
        return
    yield Element(_form(section, folder), pose)


def _form(section: ShapeSection, folder: Path) -> Form:
    if section.box is not None:
        return Box(section.box)
    if section.cylinder is not None:
        return Cylinder(section.cylinder.radius_m, section.cylinder.length_m)
    if section.capsule is not None:
        return Capsule(section.capsule.radius_m, section.capsule.length_m)
    from planning.meshes.mesh_loading import load_mesh

    assert section.mesh is not None
    file = resolve_file_name(section.mesh, folder, ShapeError)
    return load_mesh(file, section.scale, section.within_m)
