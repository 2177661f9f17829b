"""Scenario section of assembly kind ``lego``: plates, bricks in stock, and the steps or the finished structure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, model_validator

from planning.lego.bricks.assembly import (
    BRICK_LEVELS,
    BrickType,
    Cell,
    GridPlace,
    PlacedBrick,
    Support,
)
from planning.lego.bricks.brick_grips import legal_presses
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.insertion.rules import SequencingRules
from twin.document.section import Name, PairOf, Section, Several
from twin.kinds.lego.structure import (
    GridCell,
    Raised,
    StructureBrickSection,
    StructureSection,
)
from twin.scenario.sections.kind import AssemblySection
from twin.scenario.sections.shapes import Colour, PoseSection, to_planning_class

Studs = PairOf[Annotated[int, Field(ge=1, le=1000)]]
TwistDeg = Annotated[float, Field(gt=0, lt=90)]


class PlateSection(Section):
    """The base plate; ``pose`` is that of the centre of the surface bricks rest on.

    Attributes:
        pose: of the centre of the surface that bricks rest on.
        studs: along its own x and y.
    """

    pose: PoseSection
    studs: Studs = (48, 48)


class BrickSection(Section):
    """A type of brick.

    Attributes:
        studs: along its own x and y.
        mass_kg: its mass.
        height: without its studs, in thirds of a brick: 3 for a brick, 1 for a plate.
        bare: studs without a knob on top, as of a slope: x and y in the brick's own axes, from 0.
    """

    studs: Studs
    mass_kg: Annotated[float, Field(gt=0, le=1000)]
    height: Annotated[int, Field(ge=1, le=30)] = BRICK_LEVELS
    bare: tuple[PairOf[Annotated[int, Field(ge=0, le=999)]], ...] = ()

    @model_validator(mode="after")
    def _has_a_grip(self) -> BrickSection:
        own = to_planning_class(BrickType, self, name="", bare=frozenset(self.bare))
        if any(x >= self.studs[0] or y >= self.studs[1] for x, y in self.bare):
            raise ValueError(
                f"'bare' has a stud beyond {self.studs[0]} x {self.studs[1]}"
            )
        if not legal_presses(own):
            raise ValueError(
                "'bare' leaves no two knobs at an edge for the tool to hold"
            )
        return self


class StockSection(Section):
    """A brick that stands on a plate at the start.

    Attributes:
        name: unique in the scenario.
        brick: its type.
        at: stud of its least x and y (from 0) and layer (1 = on the plate).
        raised: thirds of a brick from the bottom of the layer to its own.
        turned: turned by +90 degrees about z.
        fixed: scaffolding, which no step may use.
        station: a feeding station: once a brick has been picked, the next one stands there.
    """

    name: Name
    brick: str
    at: GridCell
    raised: Raised = 0
    turned: bool = False
    fixed: bool = False
    station: bool = False

    @model_validator(mode="after")
    def _fixed_or_station(self) -> StockSection:
        if self.fixed and self.station:
            raise ValueError("a brick is fixed or a station, not both")
        return self


class PressSection(Section):
    """Grip and press of the tool: an edge of the brick, and the first stud along it.

    Attributes:
        side: for a brick that is not turned: 1 = edge of least x, 2 = of greatest y, 3 = of least
            y, 4 = of greatest x.
        offset: the tool covers studs ``offset`` and ``offset + 1``.
    """

    side: Annotated[int, Field(ge=1, le=4)]
    offset: Annotated[int, Field(ge=0, le=1000)]


class PressCellSection(Section):
    """The 1 x 2 cell in which a brick placed from below is held.

    Attributes:
        at: the cell, as stud and layer.
        raised: thirds of a brick from the bottom of the layer to the cell's.
        turned: whether the cell is 2 x 1, long along y.
    """

    at: GridCell
    raised: Raised = 0
    turned: bool = False


class SupportSection(Section):
    """Place of the supporting tool.

    Attributes:
        at: the 1 x 2 cell, as stud and layer.
        raised: thirds of a brick from the bottom of the layer to the cell's.
        orientation: 0 = the tool comes from -x, 1 = from +y, 2 = from -y, 3 = from +x.
        from_above: the tool stands on bricks (as it does for a place from below) instead of
            holding them from below.
    """

    at: GridCell
    raised: Raised = 0
    orientation: Annotated[int, Field(ge=0, le=3)]
    from_above: bool = False


class BrickStepSection(Section):
    """One step of the assembly sequence.

    Attributes:
        brick: type of the brick to place.
        at, raised, turned: where it goes, as for the stock.
        place: from above, or from below with a handover and a support on top.
        press: the grip; the planner chooses where it is not given.
        presses: the grips to choose from, ``press`` the first of them.
        press_cell: where a brick placed from below is held.
        support: where the other robot holds the structure; none where it need not.
        supports: the supports to choose from, ``support`` the first of them.
        attack: sign of the sideways offset of the approach.
        stock: name of the stock brick to use; the planner chooses where it is not given.
        colour: red, green and blue of the brick for pictures; by default that of its type.
        temporary: the brick only helps; it is not part of the structure.
    """

    brick: str
    at: GridCell
    raised: Raised = 0
    turned: bool = False
    place: Literal["down", "up"] = "down"
    press: PressSection | None = None
    presses: tuple[PressSection, ...] = ()
    press_cell: PressCellSection | None = None
    support: SupportSection | None = None
    supports: tuple[SupportSection, ...] = ()
    attack: Literal[1, -1] = 1
    stock: Name | None = None
    colour: Colour | None = None
    temporary: bool = False

    @model_validator(mode="after")
    def _first_choice(self) -> BrickStepSection:
        if self.presses and self.press != self.presses[0]:
            raise ValueError("'press' must be the first of 'presses'")
        if self.supports and self.support != self.supports[0]:
            raise ValueError("'support' must be the first of 'supports'")
        return self


class TwistSection(Section):
    """By how much the tool twists to free itself or a brick, by skill [deg].

    Attributes:
        pick: to free a brick from what it stands on.
        place_down: to let go of a brick that was pressed on from above.
        place_up: to let go of a brick that was pressed on from below.
        handover: in a handover.
    """

    model_config = ConfigDict(validate_by_name=True, validate_by_alias=True)

    pick: TwistDeg = 16.0
    place_down: Annotated[TwistDeg, Field(alias="place-down")] = 16.0
    place_up: Annotated[TwistDeg, Field(alias="place-up")] = 16.0
    handover: TwistDeg = 18.0


class RulesSection(Section):
    """Rules of the sequence of a structure: allowed insertions, and loads it must bear.

    Attributes:
        support: a second robot may hold the structure from below while a brick is pressed on.
        place_up: a brick may be handed over and pressed on from below.
        hold_down: a second robot may hold the structure down from above, beside the press.
        scaffold: temporary bricks of the stock may carry what cannot go in otherwise; they stay
            until the model is lifted off the plate. ``removable``: only such as can be taken out
            then.
        plinth: layers by which the structure is raised on temporary bricks.
        press_force_n: force at which pressing stops [N].
        press_margin: a brick is pressed on with the friction of the knobs that engage times this,
            up to the force at which pressing stops.
        search_limit: how many partial structures the search for a sequence may look at beyond
            one for each brick.
        check_steps: whether given steps must bear that force too, and stand.
    """

    support: bool = True
    place_up: bool = True
    hold_down: bool = False
    scaffold: bool | Literal["removable"] = False
    plinth: Annotated[int, Field(ge=0, le=30)] = 0
    press_force_n: Annotated[float, Field(gt=0, le=1000)] = SequencingRules.force
    press_margin: Annotated[float, Field(gt=0, le=1000)] = SequencingRules.margin
    search_limit: Annotated[int, Field(ge=0, le=1_000_000)] = (
        SequencingRules.search_limit
    )
    check_steps: bool = True


def _or_file(schema: dict[str, Any]) -> None:
    """Let editors know that a structure may have a file of its own, put in its place on reading."""
    schema["anyOf"].insert(
        1,
        {
            "type": "object",
            "description": "Read the structure from a file, relative to this one.",
            "properties": {"file": {"title": "File", "type": "string"}},
            "required": ["file"],
            "additionalProperties": False,
        },
    )


class LegoSection(AssemblySection):
    """A LEGO structure, what it is built from, and in which order.

    Attributes:
        kind: ``lego``.
        plate: the base plate of the structure.
        storage_plate: the base plate of the stock, where that is another one; scaffolding
            stands on ``plate`` all the same.
        bricks: types of bricks, added to those of the library.
        stock: bricks that are there at the start.
        steps: the assembly sequence; or else
        structure: the finished structure, whose sequence the planner finds.
        rules: what the sequence may do, and what the structure must bear.
        twist_deg: by how much the tool twists.
    """

    kind: Literal["lego"]
    plate: PlateSection
    storage_plate: PlateSection | None = None
    bricks: dict[Name, BrickSection] = Field(default_factory=dict)
    stock: Several[StockSection]
    steps: tuple[BrickStepSection, ...] = ()
    structure: Annotated[StructureSection | None, Field(json_schema_extra=_or_file)] = (
        None
    )
    rules: RulesSection = RulesSection()
    twist_deg: TwistSection = TwistSection()

    @model_validator(mode="after")
    def _steps_or_structure(self) -> LegoSection:
        if (self.structure is None) == (not self.steps):
            raise ValueError("give 'steps' or 'structure', one of them")
        return self


def brick_types(assembly: LegoSection) -> dict[str, BrickType]:
    """Return the brick types by name: the library, then those of the scenario."""
    own = assembly.bricks.items()
    return {
        **BRICKS,
        **{
            k: to_planning_class(BrickType, v, name=k, bare=frozenset(v.bare))
            for k, v in own
        },
    }


def brick_cell(item: StockSection | BrickStepSection | StructureBrickSection) -> Cell:
    """Return the cell of a brick of the stock, of a step or of a structure."""
    return Cell(*item.at, item.turned, item.raised)


def filled_grid_places(
    item: StockSection | BrickStepSection, types: Mapping[str, BrickType]
) -> frozenset[GridPlace]:
    """Return the places on the grid that a brick of the stock or of a step fills."""
    return PlacedBrick("", types[item.brick], brick_cell(item)).places


def support_place(item: SupportSection, *, up: bool = False) -> Support:
    """Return the place of a supporting tool, which is above for a place from below."""
    x, y, z = item.at
    cell = Cell(x, y, z, raised=item.raised)
    return Support(cell, item.orientation, up or item.from_above)
