"""Poses and shapes in a scenario file: box, cylinder, capsule, mesh, or a compound of those.

Structures in a scenario file: the sections, and the bricks they draw, with their places.

A structure takes the place of the steps; the planner then finds the steps itself. Drawings and
lists may be mixed: all bricks together are the structure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, TypeVar

import numpy as np
from pydantic import Field, model_validator

from planning.bounds import (
    FARTHEST,
    HEAVIEST_KG,
    LARGEST_M,
    MOST_ELEMENTS,
    MOST_JOINTS,
    THINNEST_M,
)
from planning.lego.bricks.assembly import BRICK_LEVELS, BrickType, Cell, PlacedBrick
from planning.lego.bricks.drawing import (
    Drawing,
    DrawnBrick,
    name_bricks,
    read_elevation,
    read_layer,
)
from planning.transforms import Transform, from_quat_wxyz, from_rpy, quat_wxyz, readonly
from twin.document.section import Name, Section, Three, Two
from twin.document.validation import unknown_name
from twin.document.yaml_text import KeyPath

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Coordinate = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]
Vector3 = Three[Coordinate]
Vector4 = Annotated[tuple[Coordinate, ...], Field(min_length=4, max_length=4)]
Size3 = Three[Annotated[float, Field(ge=THINNEST_M, le=LARGEST_M)]]
Colour = Three[Annotated[int, Field(ge=0, le=255)]]
Mass = Annotated[float, Field(ge=0, le=HEAVIEST_KG)]
Configuration = Annotated[
    tuple[Coordinate, ...], Field(min_length=1, max_length=MOST_JOINTS)
]


class PoseSection(Section):
    """A pose: position, and orientation (upright by default).

    Attributes:
        xyz_m: position [m].
        rpy_deg: roll, pitch, yaw with R = Rz(yaw) Ry(pitch) Rx(roll) [deg].
        quat_wxyz: the same as a quaternion (w, x, y, z).
    """

    xyz_m: Vector3
    rpy_deg: Vector3 | None = None
    quat_wxyz: Vector4 | None = None

    not_both = (("rpy_deg", "quat_wxyz"),)

    @model_validator(mode="after")
    def _real_rotation(self) -> PoseSection:
        if self.quat_wxyz is not None and not sum(v * v for v in self.quat_wxyz) > 1e-9:
            raise ValueError("quat_wxyz must not be zero")
        return self


def build_transform(pose: PoseSection) -> Transform:
    """Return a pose of the scenario as a (4, 4) transform."""
    if pose.quat_wxyz is not None:
        return from_quat_wxyz(pose.xyz_m, pose.quat_wxyz)
    rpy = np.deg2rad(pose.rpy_deg or (0.0, 0.0, 0.0))
    return from_rpy(pose.xyz_m, rpy.tolist())


def pose_section(transform: Transform) -> PoseSection:
    """Return a transform as a pose of the scenario."""
    return PoseSection(
        xyz_m=tuple(np.asarray(transform[:3, 3]).tolist()),
        quat_wxyz=tuple(np.asarray(quat_wxyz(transform)).tolist()),
    )


def as_planned(model: type[Planned], section: Section, **own: Any) -> Planned:
    """Return the data class of planning that a section describes.

    Args:
        model: the class; what it has no field for is left out.
        section: the section, see ``plain_values``.
        own: fields that the section does not give, or not in this way.
    """
    names = {field.name for field in fields(model)}
    given = {k: v for k, v in plain_values(section).items() if k in names}
    return model(**{**given, **own})


def plain_values(section: Section) -> dict[str, Any]:
    """Return what a section gives, as classes of planning have it: by names without units.

    ``size_m`` becomes ``size``, ``yaw_deg`` becomes ``yaw`` in radians, and poses become
    transforms. What has no value is left out.
    """
    out: dict[str, Any] = {}
    for key, value in section:
        name, _, unit = key.rpartition("_")
        if value is None:
            continue
        if unit == "deg":
            angles = np.deg2rad(value).tolist()
            value = tuple(angles) if isinstance(angles, list) else angles
        out[name if unit in _UNITS else key] = _plain(value)
    return out


Planned = TypeVar("Planned", bound="DataclassInstance")

_UNITS = ("m", "rad", "deg", "kg", "n", "nm")


def _plain(value: Any) -> Any:
    """Return a value with transforms for poses."""
    if isinstance(value, PoseSection):
        return readonly(build_transform(value))
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    return value


Length = Annotated[float, Field(ge=THINNEST_M, le=LARGEST_M)]
FORMS = ("box", "cylinder", "capsule", "mesh", "compound")
"""Keys of a shape, of which one is given."""


class CylinderSection(Section):
    """A cylinder, its axis along z, its middle at the origin.

    Attributes:
        radius_m: of its round side.
        length_m: from one flat end to the other.
    """

    radius_m: Length
    length_m: Length


class CapsuleSection(Section):
    """A cylinder with a half sphere at either end, its axis along z, its middle at the origin.

    Attributes:
        radius_m: of the cylinder and the half spheres.
        length_m: of the cylinder, without the half spheres; 0 for a sphere.
    """

    radius_m: Length
    length_m: Annotated[float, Field(ge=0, le=LARGEST_M)]


class ShapeSection(Section):
    """A shape: exactly one of box, cylinder, capsule, mesh and compound.

    Attributes:
        box: edge lengths along x, y and z.
        cylinder: see there.
        capsule: see there.
        mesh: path of an STL or OBJ file, relative to the scenario's.
        scale: factor from the units of the mesh to metres, such as 0.001; default 1, for a mesh that
            is no larger than 5 m then.
        within_m: how deep a hollow of the mesh may be that its convex pieces fill; default: a
            sixtieth of its longest edge.
        compound: shapes in their places, as one.
    """

    box: Size3 | None = None
    cylinder: CylinderSection | None = None
    capsule: CapsuleSection | None = None
    mesh: Annotated[str, Field(min_length=1, max_length=4096)] | None = None
    scale: Annotated[float, Field(gt=0, le=1e6)] | None = None
    within_m: Length | None = None
    compound: (
        Annotated[
            tuple[PlacedShapeSection, ...],
            Field(min_length=1, max_length=MOST_ELEMENTS),
        ]
        | None
    ) = None

    @model_validator(mode="after")
    def _one_form(self) -> ShapeSection:
        given = [key for key in FORMS if getattr(self, key) is not None]
        if len(given) != 1:
            found = " and ".join(given) if given else "none"
            raise ValueError(f"give one of {', '.join(FORMS)}, not {found}")
        if self.mesh is None and (self.scale, self.within_m) != (None, None):
            raise ValueError("scale and within_m belong to a mesh")
        return self


class PlacedShapeSection(ShapeSection):
    """A shape in its place in another one.

    Attributes:
        pose: of its frame in that of the whole.
    """

    pose: PoseSection = PoseSection(xyz_m=(0.0, 0.0, 0.0))


ShapeSection.model_rebuild()


class ShapedSection(Section):
    """Something with a shape.

    Attributes:
        size_m: edge lengths of a box along its own x, y and z: short for ``shape: {box: ..}``.
        shape: box, cylinder, capsule, mesh or compound.
    """

    size_m: Size3 | None = None
    shape: ShapeSection | None = None

    not_both: ClassVar[tuple[tuple[str, ...], ...]] = (("size_m", "shape"),)

    @model_validator(mode="after")
    def _some_shape(self) -> Self:
        if self.size_m is None and self.shape is None:
            raise ValueError("key 'size_m' is missing: give it for a box, or a shape")
        return self

    @property
    def described(self) -> ShapeSection:
        """The shape, whichever way it is given."""
        return self.shape or ShapeSection(box=self.size_m)

    @property
    def shape_words(self) -> str:
        """What kind of thing it is: a box by its edges, others by what they are."""
        shape = self.described
        if shape.box is not None:
            return " x ".join(f"{edge:g}" for edge in shape.box)
        if shape.mesh is not None:
            return f"mesh {shape.mesh}"
        if shape.compound is not None:
            return f"compound of {len(shape.compound)}"
        round_one = shape.cylinder or shape.capsule
        assert round_one is not None
        form = "capsule" if shape.cylinder is None else "cylinder"
        return f"{form} {2 * round_one.radius_m:g} x {round_one.length_m:g}"


Stud2 = Two[Annotated[int, Field(ge=-1000, le=1000)]]
GridCell = Three[Annotated[int, Field(ge=-1000, le=1000)]]
Raised = Annotated[int, Field(ge=0, lt=BRICK_LEVELS)]


class ElevationSection(Section):
    """A side view, every line of which is one layer; its bricks are equally deep.

    Attributes:
        at: stud and layer of the lower left character (the nearest stud in depth).
        along: the direction that runs to the right.
        depth: studs in the other direction.
        drawing: lines from the top layer down; each run of one letter is a brick, '.' is empty.
    """

    at: GridCell
    along: Literal["x", "y"] = "y"
    depth: Annotated[int, Field(ge=1, le=100)] = 2
    drawing: str


class StructureBrickSection(Section):
    """A brick of a structure: its type, and where it goes (as for the stock).

    Attributes:
        brick: its type.
        at: stud of its least x and y (from 0) and layer (1 = on the plate).
        raised: thirds of a brick from the bottom of the layer to the brick's.
        turned: by +90 degrees about z.
        name: unique in the structure; made of its type and place where it is not given.
        colour: red, green and blue for pictures; by default that of its type.
    """

    brick: str
    at: GridCell
    raised: Raised = 0
    turned: bool = False
    name: Name | None = None
    colour: Colour | None = None


class StructureSection(Section):
    """A finished structure.

    Attributes:
        origin: stud of the lower left character of every layer.
        layers: from the plate up, seen from above with x to the right and y upwards; each patch
            of one letter is a brick, '.' is empty.
        elevations: side views.
        bricks: one by one.
    """

    origin: Stud2 | None = None
    layers: tuple[str, ...] = ()
    elevations: tuple[ElevationSection, ...] = ()
    bricks: tuple[StructureBrickSection, ...] = ()

    @model_validator(mode="after")
    def _something(self) -> StructureSection:
        if not (self.layers or self.elevations or self.bricks):
            raise ValueError("give 'layers', 'elevations' or 'bricks'")
        if self.layers and self.origin is None:
            raise ValueError(
                "layers need an 'origin': the stud of their lower left corner"
            )
        return self


@dataclass(frozen=True)
class ReadStructure:
    """The bricks of a structure section.

    Attributes:
        bricks: all of them, with names of their own.
        places: for each brick, the path of the value it is in, with its spot in a drawing.
        problems: what is wrong, each with its place.
    """

    bricks: tuple[PlacedBrick, ...]
    places: tuple[KeyPath, ...]
    problems: tuple[tuple[KeyPath, str], ...]


def read_structure(
    section: StructureSection, types: Mapping[str, BrickType]
) -> ReadStructure:
    """Return the bricks of a structure.

    Args:
        section: what the file says.
        types: brick types by name.
    """
    drawn: list[DrawnBrick] = []
    places: list[KeyPath] = []
    problems: list[tuple[KeyPath, str]] = []
    for path, drawing in _drawings(section, types):
        drawn += drawing.bricks
        places += [(*path, item.spot) for item in drawing.bricks]
        problems += [((*path, spot), message) for spot, message in drawing.problems]
    given: dict[int, tuple[int, str]] = {}
    for i, item in enumerate(section.bricks):
        if item.brick not in types:
            unknown = unknown_name("brick type", item.brick, tuple(types))
            problems.append((("bricks", i, "brick"), unknown))
            continue
        if item.name is not None:
            given[len(drawn)] = i, item.name
        cell = Cell(*item.at, item.turned, item.raised)
        stem = item.name or f"{item.brick}_"
        drawn.append(DrawnBrick(stem, types[item.brick], cell, (0, 0)))
        places.append(("bricks", i, "at"))
    bricks = list(name_bricks(drawn))
    for k, (_, name) in given.items():
        bricks[k] = replace(bricks[k], name=name)
    counts = Counter(item.name for item in bricks)
    for i, name in given.values():
        if counts[name] > 1:
            message = f"another brick is called {name!r} too"
            problems.append((("bricks", i, "name"), message))
    return ReadStructure(tuple(bricks), tuple(places), tuple(problems))


def _drawings(
    section: StructureSection, types: Mapping[str, BrickType]
) -> Iterator[tuple[KeyPath, Drawing]]:
    for k, text in enumerate(section.layers):
        assert section.origin is not None
        if text.strip() or k == len(section.layers) - 1:
            yield ("layers", k), read_layer(text, section.origin, k + 1, types)
    for k, view in enumerate(section.elevations):
        shown = view.drawing, view.at, view.along, view.depth
        yield ("elevations", k, "drawing"), read_elevation(*shown, types)
