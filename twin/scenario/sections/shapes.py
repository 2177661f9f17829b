"""Poses and shapes in a scenario file: box, cylinder, capsule, mesh, or a compound of those."""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from planning.transforms import Transform, from_quat_wxyz, from_rpy, readonly
from twin.scenario.document.section import Section, Several, Three

# No cell reaches ten kilometres: what is beyond is a slip of the pen or of the unit.
Coordinate = Annotated[float, Field(ge=-1e4, le=1e4)]
Vector3 = Three[Coordinate]
Vector4 = Annotated[tuple[Coordinate, ...], Field(min_length=4, max_length=4)]
# Bodies thinner than a tenth of a millimetre have no volume that could be reckoned with.
Size3 = Three[Annotated[float, Field(ge=1e-4, le=1000)]]
Colour = Three[Annotated[int, Field(ge=0, le=255)]]
Mass = Annotated[float, Field(ge=0, le=1e6)]
Configuration = Annotated[tuple[Coordinate, ...], Field(min_length=1, max_length=100)]


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

    @model_validator(mode="after")
    def _one_rotation(self) -> PoseSection:
        if self.rpy_deg is not None and self.quat_wxyz is not None:
            raise ValueError("give rpy_deg or quat_wxyz, not both")
        if self.quat_wxyz is not None and not sum(v * v for v in self.quat_wxyz) > 1e-9:
            raise ValueError("quat_wxyz must not be zero")
        return self


def build_transform(pose: PoseSection) -> Transform:
    """Return a pose of the scenario as a (4, 4) transform."""
    if pose.quat_wxyz is not None:
        return from_quat_wxyz(pose.xyz_m, pose.quat_wxyz)
    rpy = np.deg2rad(pose.rpy_deg or (0.0, 0.0, 0.0))
    return from_rpy(pose.xyz_m, rpy.tolist())


def plain_values(section: Section, *, without: Collection[str] = ()) -> dict[str, Any]:
    """Return what a section gives, as classes of planning have it: by names without units.

    ``size_m`` becomes ``size``, ``yaw_deg`` becomes ``yaw`` in radians, and poses become
    transforms. What has no value is left out.

    Args:
        section: the section.
        without: keys to leave out.
    """
    out: dict[str, Any] = {}
    for key, value in section:
        name, _, unit = key.rpartition("_")
        if key in without or value is None:
            continue
        if unit == "deg":
            angles = np.deg2rad(value).tolist()
            value = tuple(angles) if isinstance(angles, list) else angles
        out[name if unit in _UNITS else key] = _plain(value)
    return out


_UNITS = ("m", "rad", "deg", "kg")


def _plain(value: Any) -> Any:
    """Return a value with transforms for poses."""
    if isinstance(value, PoseSection):
        return readonly(build_transform(value))
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    return value


Length = Annotated[float, Field(ge=1e-4, le=1000)]
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
    length_m: Annotated[float, Field(ge=0, le=1000)]


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
    compound: Several[PlacedShapeSection] | None = None

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

    @model_validator(mode="after")
    def _one_shape(self) -> Self:
        if self.size_m is None and self.shape is None:
            raise ValueError("key 'size_m' is missing: give it for a box, or a shape")
        if self.size_m is not None and self.shape is not None:
            raise ValueError("give size_m or shape, not both")
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
