"""Scenario section of assembly kind ``construction``: a structure of parts, given by a model or a list."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from twin.document.section import Name, PairOf, Section, Several
from twin.kinds.statics import BalanceSection, JoinedParts
from twin.scenario.sections.kind import AssemblySection
from twin.scenario.sections.shapes import (
    Colour,
    Coordinate,
    Mass,
    PoseSection,
    Size3,
    Vector3,
)

Length = Annotated[float, Field(ge=0.001, le=100)]
Face = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
Pair = PairOf[Length]


class TowerSection(Section):
    """Beams stacked crosswise: each rests on the one before.

    Attributes:
        name: ``tower``.
        levels: number of beams.
        size_m: of a beam.
    """

    name: Literal["tower"]
    levels: Annotated[int, Field(ge=1, le=200)] = 15
    size_m: Size3 = (0.6, 0.2, 0.12)


class WallSection(Section):
    """A straight wall of blocks in running bond.

    Attributes:
        name: ``wall``.
        columns: blocks of a course.
        courses: number of courses.
        size_m: of a block.
        joint_m: gap between the blocks of a course.
    """

    name: Literal["wall"]
    columns: Annotated[int, Field(ge=1, le=200)] = 9
    courses: Annotated[int, Field(ge=1, le=100)] = 4
    size_m: Size3 = (0.5, 0.2, 0.2)
    joint_m: Annotated[float, Field(ge=0, le=1)] = 0.01


class WellSection(Section):
    """A ring wall of blocks.

    Attributes:
        name: ``well``.
        sides: blocks of a course.
        courses: number of courses.
        radius_m: of the circle that the blocks touch from outside.
        section_m: thickness and height of a block.
        joint_m: gap between the inner edges of blocks.
    """

    name: Literal["well"]
    sides: Annotated[int, Field(ge=3, le=200)] = 13
    courses: Annotated[int, Field(ge=1, le=100)] = 4
    radius_m: Length = 0.86
    section_m: Pair = (0.18, 0.18)
    joint_m: Annotated[float, Field(ge=0, le=1)] = 0.012


class PavilionSection(Section):
    """A vault of arches of wooden cassettes, no two of one size.

    Attributes:
        name: ``pavilion``.
        arches: number of cassettes of each arch.
        chord_m: mean length of a cassette along its arch.
        depth_m: length of a cassette along the vault, in the first arch.
        thickness_m: of a cassette.
        joint_m: gap between inner edges of neighbours, and between arches.
        crown_deg: cassettes that stand higher above the horizon are held from inside.
    """

    name: Literal["pavilion"]
    arches: Several[Annotated[int, Field(ge=3, le=200)]] = (15, 16, 17, 17, 17, 16, 15)
    chord_m: Length = 0.4
    depth_m: Length = 0.66
    thickness_m: Length = 0.14
    joint_m: Annotated[float, Field(ge=0, le=1)] = 0.012
    crown_deg: Annotated[float, Field(ge=0, le=90)] = 50.0


ModelSection = Annotated[
    TowerSection | WallSection | WellSection | PavilionSection,
    Field(discriminator="name"),
]
"""A model to build; ``name`` says which one."""


class ConstructionPartSection(Section):
    """A box of one's own.

    Attributes:
        name: unique in the scenario.
        size_m: edge lengths along its own x, y and z.
        goal: pose of its centre where it belongs.
        start: pose of its centre at the start; where the supply's layout puts it if not given.
        mass_kg: its mass.
        faces: faces that a tool may touch; laid out by the supply, the first of them is up.
        insertion: direction of the straight way on which it reaches its place; against the
            first face if not given.
        colour: red, green, blue.
    """

    name: Name
    size_m: Size3
    goal: PoseSection
    start: PoseSection | None = None
    mass_kg: Mass = 0.0
    faces: Several[Face] = ("+z",)
    insertion: Vector3 | None = None
    colour: Colour = (200, 170, 120)

    @model_validator(mode="after")
    def _real_direction(self) -> ConstructionPartSection:
        if self.insertion is not None and not any(self.insertion):
            raise ValueError("insertion must not be zero")
        return self


class SpiralSection(Section):
    """Parts on a spiral around the site; the defaults are those of Hartmann et al.

    Attributes:
        layout: ``spiral``.
        radius_m: distance of the first part from the origin.
        growth_m: how much further out each next part lies.
        turn_rad: angle from one part to the next.
        across: whether parts lie with their longer edge across the radius, not along it.
        near: whether every part lies near where it belongs, as far as others leave it room; by
            default parts lie in their order.
        high: parts of a stack, the first ones on top.
    """

    layout: Literal["spiral"]
    radius_m: Length = 3.0
    growth_m: Annotated[float, Field(ge=0, le=10)] = 0.05
    turn_rad: Coordinate = 0.5
    across: bool = False
    near: bool = False
    high: Annotated[int, Field(ge=1, le=100)] = 1


class RowsSection(Section):
    """Parts in rows on one side of the site.

    Attributes:
        layout: ``rows``.
        first_m: x and y of the middle of the first row.
        columns: parts of a row.
        pitch_m: distance of parts in a row, and of rows.
        yaw_deg: direction in which further rows lie.
        near: whether every part lies near where it belongs, as far as others leave it room; by
            default parts lie in their order.
        high: parts of a stack, the first ones on top.
    """

    layout: Literal["rows"]
    first_m: PairOf[Coordinate]
    columns: Annotated[int, Field(ge=1, le=1000)]
    pitch_m: Pair
    yaw_deg: Coordinate = 0.0
    near: bool = False
    high: Annotated[int, Field(ge=1, le=100)] = 1


SupplySection = Annotated[SpiralSection | RowsSection, Field(discriminator="layout")]
"""Layout of the parts at the start, by ``layout``."""


class PadSection(Section):
    """Grips of vacuum pads on the parts.

    Attributes:
        frame: tool frame; its origin is in the middle of the pad, its z axis points out of it.
        offsets_m: places along the longer edge of a face, from its middle; any of them may be used.
    """

    frame: Name = "tool"
    offsets_m: Several[Coordinate] = (0.0,)


class ConstructionSection(AssemblySection):
    """A construction: what is built, where its parts lie, and how they are held.

    Attributes:
        kind: ``construction``.
        model: a model; or else
        parts: parts of one's own.
        supply: where the parts lie at the start.
        grips: where pads touch the parts.
        approach_m: straight way before and after a touch, and of a part before it reaches and
            after it leaves a place.
        touch_m: parts nearer to each other than this are connected.
        carried: whether a part waits for everything that it rests on; without, one placed
            neighbour is enough.
        balance: friction under which everything must always stand.
        joined: pairs of parts, or of a part and a fixture (``ground`` is the floor), that are joined
            once both are there; ``neighbours`` joins each to all that it is connected with.
        ground_m: edge length of the floor, whose top is at height zero.
    """

    kind: Literal["construction"]
    model: ModelSection | None = None
    parts: tuple[ConstructionPartSection, ...] = ()
    supply: SupplySection = SpiralSection(layout="spiral")
    grips: PadSection = PadSection()
    approach_m: Annotated[float, Field(gt=0, le=1)] = 0.1
    touch_m: Annotated[float, Field(gt=0, le=0.5)] = 0.03
    carried: bool = True
    balance: BalanceSection = BalanceSection()
    joined: Literal["neighbours"] | tuple[JoinedParts, ...] = ()
    ground_m: Length = 30.0

    @model_validator(mode="after")
    def _model_or_parts(self) -> ConstructionSection:
        if (self.model is None) == (not self.parts):
            raise ValueError("give 'model' or 'parts', one of them")
        return self
