"""Shapes in a scenario file: box, cylinder, capsule, mesh, or a compound of those."""

from __future__ import annotations

from typing import Annotated

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
        if self.mesh is None and {"scale", "within_m"} & self.model_fields_set:
            raise ValueError("scale and within_m belong to a mesh")
        return self


class PlacedShapeSection(ShapeSection):
    """A shape in its place in another one.

    Attributes:
        pose: of its frame in that of the whole.
    """

    pose: PoseSection = PoseSection(xyz_m=(0.0, 0.0, 0.0))


ShapeSection.model_rebuild()
