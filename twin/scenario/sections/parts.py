"""Assemblies of kind ``assembly``: boxes, beams and rods, each put in its place by one robot."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from twin.scenario.document.section import Name, Section, Several, Three
from twin.scenario.sections.poses import Mass, PoseSection, Size3, Vector3

Distance = Annotated[float, Field(ge=1e-4, le=1)]
Colour = Three[Annotated[int, Field(ge=0, le=255)]]


class PartSection(Section):
    """A box that is handled.

    Attributes:
        name: unique in the scenario.
        size_m: edge lengths along its own x, y and z.
        start: pose of its centre in the world at the start.
        goal: pose of its centre once it is in place; a part without one stays where it is.
        mass_kg: its mass.
        colour: red, green, blue.
    """

    name: Name
    size_m: Size3
    start: PoseSection
    goal: PoseSection | None = None
    mass_kg: Mass = 0.0
    colour: Colour = (190, 140, 90)


class GripSection(Section):
    """Rules for the grips that are tried.

    Attributes:
        frame: tool frame; its z axis points out of the hand, its fingers close along y.
        positions: places along the longest edge of a part.
        end_margin_m: distance of the outermost place from the end.
        opening_m: widest edge that fits between the fingers.
        depth_m: how far the tool frame goes below the face it comes from, at most to the
            middle of the part.
        directions: directions in the world along which the tool may point.
        steepest_deg: largest angle between the tool and the nearest of them.
        tilts_deg: leanings of the tool about the axis along which its fingers close.
    """

    frame: Name = "tool"
    positions: Annotated[int, Field(ge=1, le=50)] = 5
    end_margin_m: Annotated[float, Field(ge=0, le=1)] = 0.02
    opening_m: Distance = 0.04
    depth_m: Distance = 0.03
    directions: Several[Vector3] = ((0.0, 0.0, -1.0),)
    steepest_deg: Annotated[float, Field(ge=0, le=180)] = 60.0
    tilts_deg: Several[Annotated[float, Field(gt=-90, lt=90)]] = (0.0,)

    @model_validator(mode="after")
    def _real_directions(self) -> GripSection:
        if any(sum(v * v for v in d) < 1e-9 for d in self.directions):
            raise ValueError("a direction must not be zero")
        return self


class PartsSection(Section):
    """Parts, where they go, and in which order.

    Attributes:
        kind: ``assembly``.
        parts: everything that can be handled.
        steps: names of the parts in the order in which they are put in place.
        approach_m: straight way towards a part before it is gripped, and straight down with
            it before it is put in place.
        leave_m: straight way up with a part, and back from it once it is in place.
        touch_m: parts nearer to each other than this touch: the later one waits for the
            earlier one.
        grips: which grips are tried.
    """

    kind: Literal["assembly"]
    parts: Several[PartSection]
    steps: Several[Name]
    approach_m: Distance = 0.06
    leave_m: Distance = 0.06
    touch_m: Annotated[float, Field(gt=0, le=0.05)] = 0.002
    grips: GripSection = GripSection()
