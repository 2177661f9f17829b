"""Shapes in a scenario file: box, cylinder, capsule, mesh, or a compound of those."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from twin.scenario.document.section import Section, Several
from twin.scenario.sections.poses import PoseSection, Size3

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
