"""Scenario sections for poses and shapes: box, cylinder, capsule, mesh, or a compound of them."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, TypeVar

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
from planning.transforms import (
    Transform,
    from_quat_wxyz,
    from_rpy,
    quat_wxyz,
    read_only_copy,
)
from twin.document.section import Section, TripleOf

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Coordinate = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]
Vector3 = TripleOf[Coordinate]
Vector4 = Annotated[tuple[Coordinate, ...], Field(min_length=4, max_length=4)]
Size3 = TripleOf[Annotated[float, Field(ge=THINNEST_M, le=LARGEST_M)]]
Colour = TripleOf[Annotated[int, Field(ge=0, le=255)]]
Mass = Annotated[float, Field(ge=0, le=HEAVIEST_KG)]
Configuration = Annotated[
    tuple[Coordinate, ...], Field(min_length=1, max_length=MOST_JOINTS)
]
Planned = TypeVar("Planned", bound="DataclassInstance")

_UNITS = ("m", "rad", "deg", "kg", "n", "nm")
Length = Annotated[float, Field(ge=THINNEST_M, le=LARGEST_M)]
FORMS = ("box", "cylinder", "capsule", "mesh", "compound")
"""Keys of a shape, of which one is given."""


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

    @staticmethod
    def of(transform: Transform) -> PoseSection:
        """Return a transform as a pose of the scenario."""
        return PoseSection(
            xyz_m=tuple(np.asarray(transform[:3, 3]).tolist()),
            quat_wxyz=tuple(np.asarray(quat_wxyz(transform)).tolist()),
        )

    def transform(self) -> Transform:
        """Return the pose as a (4, 4) transform."""
        if self.quat_wxyz is not None:
            return from_quat_wxyz(self.xyz_m, self.quat_wxyz)
        rpy = np.deg2rad(self.rpy_deg or (0.0, 0.0, 0.0))
        return from_rpy(self.xyz_m, rpy.tolist())


def to_planning_class(model: type[Planned], section: Section, **own: Any) -> Planned:
    """Return the planning data class that a section describes.

    Args:
        model: the class; values without a field are omitted.
        section: the section, see ``plain_values``.
        own: fields missing in the section, or in another form there.
    """
    names = {field.name for field in fields(model)}
    given = {k: v for k, v in plain_values(section).items() if k in names}
    return model(**{**given, **own})


def plain_values(section: Section) -> dict[str, Any]:
    """Return the values of a section by their names in planning, without units.

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


def _plain(value: Any) -> Any:
    """Return a value with poses converted to transforms."""
    if isinstance(value, PoseSection):
        return read_only_copy(value.transform())
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    return value


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
