"""What a scenario file may say: one cell, one assembly, how to plan and how to run it.

These are the sections and keys of the file, frozen and checked one by one. Reading a file and
checking that the parts fit together is in ``twin.scenario_file``; every quantity carries its unit
in its key.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from twin.scenario_base import Name, PoseSection, Section, Size3
from twin.scenario_execution import ExecutionSection as ExecutionSection
from twin.scenario_goals import GoalsSection
from twin.scenario_lego import LegoSection
from twin.scenario_pick_place import PickPlaceSection


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
