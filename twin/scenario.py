"""What a scenario file may say: one cell, one assembly, how to plan and how to run it.

These are the sections and keys of the file, frozen and checked one by one. Reading a file and
checking that the parts fit together is in ``twin.scenario_file``; every quantity carries its unit
in its key.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, model_validator

from twin.scenario_base import Name, PoseSection, Section, Size3
from twin.scenario_durations import DurationSection
from twin.scenario_goals import GoalsSection
from twin.scenario_pick_place import PickPlaceSection
from twin.scenario_structure import StructureSection

Studs = Annotated[
    tuple[Annotated[int, Field(ge=1, le=1000)], ...],
    Field(min_length=2, max_length=2),
]
GridCell = Annotated[
    tuple[Annotated[int, Field(ge=-1000, le=1000)], ...],
    Field(min_length=3, max_length=3),
]
Skill = Literal[
    "pick",
    "place-down",
    "place-up",
    "handover",
    "support-bottom",
    "support-top",
]


class RobotSection(Section):
    """A robot of the cell.

    Attributes:
        name: unique in the cell.
        model: a name that ``twin robots`` lists, or the path of a URDF, relative to the file.
        base: pose of the base in the world.
        home_deg: HOME of a robot with revolute joints only [deg]; default: the model's.
        home_rad_or_m: HOME of any robot, joint by joint [rad or m].
        frames: tool frames, each a pose in the flange frame; they replace the model's.
    """

    name: Name
    model: str
    base: PoseSection
    home_deg: tuple[float, ...] | None = None
    home_rad_or_m: tuple[float, ...] | None = None
    frames: dict[Name, PoseSection] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _one_home(self) -> RobotSection:
        if self.home_deg is not None and self.home_rad_or_m is not None:
            raise ValueError("give home_deg or home_rad_or_m, not both")
        return self


class FixtureSection(Section):
    """An immovable box; ``pose`` is that of its centre in the world."""

    name: Name
    size_m: Size3
    pose: PoseSection


class ClearanceSection(Section):
    """Least distances kept: between robots, and between a robot and anything else."""

    robot_robot_m: Annotated[float, Field(ge=0, le=1)] = 0.001
    robot_object_m: Annotated[float, Field(ge=0, le=1)] = 0.0


class CellSection(Section):
    """Who works, and what stands around."""

    robots: Annotated[tuple[RobotSection, ...], Field(min_length=1)]
    fixtures: tuple[FixtureSection, ...] = ()
    clearance: ClearanceSection = ClearanceSection()


class PlateSection(Section):
    """The base plate; ``pose`` is that of the centre of the surface bricks rest on."""

    pose: PoseSection
    studs: Studs = (48, 48)


class BrickSection(Section):
    """A type of brick: studs along its own x and y, and its mass."""

    studs: Studs
    mass_kg: Annotated[float, Field(gt=0)]


class StockSection(Section):
    """A brick that stands on a plate at the start.

    Attributes:
        name: unique in the scenario.
        brick: its type.
        at: stud of its least x and y (from 0) and layer (1 = on the plate).
        turned: turned by +90 degrees about z.
        fixed: scaffolding, which no step may use.
        station: a feeding station: once a brick has been picked, the next one stands there.
    """

    name: Name
    brick: str
    at: GridCell
    turned: bool = False
    fixed: bool = False
    station: bool = False

    @model_validator(mode="after")
    def _fixed_or_station(self) -> StockSection:
        if self.fixed and self.station:
            raise ValueError("a brick is fixed or a station, not both")
        return self


class PressSection(Section):
    """Where the tool grips and presses: an edge of the brick, and the first stud along it.

    Attributes:
        side: for a brick that is not turned: 1 = edge of least x, 2 = of greatest y, 3 = of least
            y, 4 = of greatest x.
        offset: the tool covers studs ``offset`` and ``offset + 1``.
    """

    side: Annotated[int, Field(ge=1, le=4)]
    offset: Annotated[int, Field(ge=0)]


class PressCellSection(Section):
    """The 1 x 2 cell in which a brick placed from below is held."""

    at: GridCell
    turned: bool = False


class SupportSection(Section):
    """Where the supporting tool goes.

    Attributes:
        at: the 1 x 2 cell, as stud and layer.
        orientation: 0 = the tool comes from -x, 1 = from +y, 2 = from -y, 3 = from +x.
    """

    at: GridCell
    orientation: Annotated[int, Field(ge=0, le=3)]


class StepSection(Section):
    """One step of the assembly sequence.

    Attributes:
        brick: type of the brick to place.
        at, turned: where it goes, as for the stock.
        place: from above, or from below with a handover and a support on top.
        press: the grip; the planner chooses where it is not given.
        presses: the grips to choose from, ``press`` the first of them.
        press_cell: where a brick placed from below is held.
        support: where the other robot holds the structure; none where it need not.
        supports: the supports to choose from, ``support`` the first of them.
        attack: sign of the sideways offset of the approach.
        stock: name of the stock brick to use; the planner chooses where it is not given.
    """

    brick: str
    at: GridCell
    turned: bool = False
    place: Literal["down", "up"] = "down"
    press: PressSection | None = None
    presses: tuple[PressSection, ...] = ()
    press_cell: PressCellSection | None = None
    support: SupportSection | None = None
    supports: tuple[SupportSection, ...] = ()
    attack: Literal[1, -1] = 1
    stock: Name | None = None

    @model_validator(mode="after")
    def _first_choice(self) -> StepSection:
        if self.presses and self.press != self.presses[0]:
            raise ValueError("'press' must be the first of 'presses'")
        if self.supports and self.support != self.supports[0]:
            raise ValueError("'support' must be the first of 'supports'")
        return self


TwistDeg = Annotated[float, Field(gt=0, lt=90)]


class TwistSection(Section):
    """By how much the tool twists to free itself or a brick, by skill [deg]."""

    model_config = ConfigDict(validate_by_name=True, validate_by_alias=True)

    pick: TwistDeg = 16.0
    place_down: Annotated[TwistDeg, Field(alias="place-down")] = 16.0
    place_up: Annotated[TwistDeg, Field(alias="place-up")] = 16.0
    handover: TwistDeg = 18.0


class LegoSection(Section):
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
        twist_deg: by how much the tool twists.
    """

    kind: Literal["lego"]
    plate: PlateSection
    storage_plate: PlateSection | None = None
    bricks: dict[Name, BrickSection] = Field(default_factory=dict)
    stock: Annotated[tuple[StockSection, ...], Field(min_length=1)]
    steps: tuple[StepSection, ...] = ()
    structure: StructureSection | None = None
    twist_deg: TwistSection = TwistSection()

    @model_validator(mode="after")
    def _steps_or_structure(self) -> LegoSection:
        if (self.structure is None) == (not self.steps):
            raise ValueError("give 'steps' or 'structure', one of them")
        return self


AssemblySection = Annotated[
    LegoSection | PickPlaceSection | GoalsSection, Field(discriminator="kind")
]
"""What is built; ``kind`` says which of them it is."""


class PlanningSection(Section):
    """How the planner works.

    Attributes:
        speed_model: ``l1`` moves at a constant sum of joint speeds, as APEX-MR does; ``joint``
            keeps each joint within its own limit.
        speed_rad_s: the speed of the ``l1`` model [rad/s].
        step_s: time between the waypoints of a path [s].
        attempts: transit searches, each longer than the one before, until the planner gives up.
        coordination: ``sequential`` plans one task after another; ``synchronous`` turns that
            into slots in which robots move at once.
        shortcut_candidates: shortcuts tried on the temporal plan graph; 0 leaves it as planned.
    """

    speed_model: Literal["l1", "joint"] = "l1"
    speed_rad_s: Annotated[float, Field(gt=0)] = 1.0
    step_s: Annotated[float, Field(gt=0, le=10)] = 0.05
    attempts: Annotated[int, Field(ge=1, le=1000)] = 5
    coordination: Literal["sequential", "synchronous"] = "sequential"
    shortcut_candidates: Annotated[int, Field(ge=0, le=10_000_000)] = 0


class StallsSection(Section):
    """Standstills at random times, as when a robot waits for a person.

    Attributes:
        count_per_robot: how many each robot suffers.
        duration_s: shortest and longest [s].
    """

    count_per_robot: Annotated[int, Field(ge=0, le=100_000)] = 0
    duration_s: Annotated[
        tuple[Annotated[float, Field(ge=0)], ...], Field(min_length=2, max_length=2)
    ] = (1.0, 20.0)

    @model_validator(mode="after")
    def _ordered(self) -> StallsSection:
        if self.duration_s[0] > self.duration_s[1]:
            raise ValueError("duration_s is [shortest, longest]")
        return self


class ExecutionSection(Section):
    """How the plan is executed.

    Attributes:
        policy: ``asynchronous`` releases a node as soon as what it waits for is complete;
            ``sequential`` runs one task at a time; ``synchronous`` runs a plan made in slots
            slot by slot.
        queue_depth: nodes that a robot may have been given ahead.
        latency_s: time from a completion to the release it causes [s].
        skills: duration models by skill; the packaged synthetic timings where not given.
        stalls: random standstills.
    """

    policy: Literal["asynchronous", "sequential", "synchronous"] = "asynchronous"
    queue_depth: Annotated[int, Field(ge=1, le=100_000)] = 1
    latency_s: Annotated[float, Field(ge=0, le=3600)] = 0.0
    skills: dict[Skill, DurationSection] = Field(default_factory=dict)
    stalls: StallsSection = StallsSection()


class Scenario(Section):
    """A whole scenario file."""

    version: Literal[1]
    name: Name
    description: str = ""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    cell: CellSection
    assembly: AssemblySection
    planning: PlanningSection = PlanningSection()
    execution: ExecutionSection = ExecutionSection()

    @model_validator(mode="after")
    def _slots_to_execute(self) -> Scenario:
        if (
            self.execution.policy == "synchronous"
            and self.planning.coordination != "synchronous"
        ):
            raise ValueError(
                "policy 'synchronous' needs a plan in slots: set the planning's"
                " coordination to 'synchronous'"
            )
        return self


def resolved(scenario: Scenario) -> dict[str, Any]:
    """Return the scenario with every default filled in, ready for JSON."""
    return scenario.model_dump(mode="json", by_alias=True)


def fingerprint(scenario: Scenario) -> str:
    """Return the SHA-256 of the resolved scenario; equal scenarios have equal ones."""
    from twin.run_folder import scenario_sha256

    return scenario_sha256(resolved(scenario))
