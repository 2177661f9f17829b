"""Top section of a scenario file: one cell, one assembly, and settings of planning and execution.

Sections are immutable, and each checks its own values. The package ``twin.reading`` reads a file and checks that its
sections are consistent. The key of every quantity contains its unit.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union

from pydantic import (
    AfterValidator,
    Field,
    GetCoreSchemaHandler,
    ValidationError,
    model_validator,
)
from pydantic_core import CoreSchema, core_schema

from planning.bounds import LONGEST_S
from planning.errors import ScenarioError
from planning.tasks.task import ActuationKey, TaskKind
from twin.document.section import Name, Section, docstring_attributes, iterate_nested
from twin.durations.composed import AnyDuration, SkillOverride
from twin.durations.model import DurationModel, Skill
from twin.registry import KINDS, PLANNERS, SECTIONS
from twin.scenario.sections.cell import CellSection as CellSection
from twin.scenario.sections.cell import FixtureSection as FixtureSection
from twin.scenario.sections.cell import RobotSection as RobotSection
from twin.scenario.sections.execution import ExecutionSection as ExecutionSection
from twin.scenario.sections.kind import (
    AssemblyKind,
    AssemblySection,
    SpeedModelName,
    assembly_kind,
)
from twin.uncertainty.base_errors import PoseErrorSection


@dataclass(frozen=True)
class _OnlyKind:
    """Mark of a section that makes pydantic ask its kind first, as it does of a union."""

    kind: str

    def __get_pydantic_core_schema__(
        self, section: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        choices = {self.kind: handler(section)}
        return core_schema.tagged_union_schema(choices, discriminator="kind")


def _any_assembly() -> Any:
    """Return the union type of the assembly sections of all kinds, by ``kind``."""
    kinds = KINDS.load_all()
    sections = [kind.section_class for kind in kinds.values()]
    if len(sections) == 1:
        return Annotated[sections[0], _OnlyKind(next(iter(kinds)))]
    return Annotated[Union[tuple(sections)], Field(discriminator="kind")]  # noqa: UP007


if TYPE_CHECKING:
    AnyAssembly = AssemblySection
else:
    AnyAssembly = _any_assembly()


def _registered_planner(name: str) -> str:
    if name not in PLANNERS:
        choices = ", ".join(PLANNERS.names())
        raise ValueError(f"unknown transit planner {name!r} (valid: {choices})")
    return name


class PlanningSection(Section):
    """Settings of the planner.

    Attributes:
        speed_model: ``limits`` keeps each joint within its limits of speed, acceleration and jerk,
            as controllers do; ``joint`` within its limit of speed alone; ``l1`` moves at a constant
            sum of joint speeds, as APEX-MR does. Default: ``limits``, but for the kinds lego (``l1``)
            and construction (``joint``), which are planned as in the papers.
        speed_rad_s: the speed of the ``l1`` model, 1 by default, and where it is given the greatest
            sum of joint speeds of the ``limits`` model [rad/s]; the path of a plan is as long as its
            time, so slower ones than 0.01 take more memory than a plan is worth.
        corners: with the ``limits`` model, whether robots pass corners of transits at speed, on a
            curve, where that is free and shortens the plan: ``smooth``; or ``rest`` at all.
        step_s: time between the waypoints of a path [s].
        planner: what finds paths of transits, by its name in the registry: ``rrt-connect``, or one that a package or a
            script adds.
        attempts: transit searches, each longer than the one before, until the planner gives up.
        assignment: ``search`` looks for an assignment that is predicted to end sooner than that of the integer
            program, and orders tasks for straight transits; ``paper`` takes that of the program, as APEX-MR does;
            ``auto`` searches for LEGO structures.
        assignment_moves: assignments that ``search`` looks at; ``auto`` goes by the number of steps.
        coordination: ``sequential`` plans one task after another; ``synchronous`` turns that
            into slots in which robots move at once.
        joint_planning: which transits of a plan in slots are planned as one robot: ``conflicts``
            those that would collide, where that saves time; ``always`` all that are in one
            slot, as APEX-MR's synchronous baseline does.
        paths: what finds the paths of a construction: ``auto`` tries straight ways first, then a
            roadmap, and the space-time RRT where these fail; ``rrt`` that alone, as Hartmann et al.
        shortcut_candidates: most shortcuts tried on the temporal plan graph, after its tasks were
            put into a better order; 0 leaves it as planned, ``auto`` goes by the number of steps.
        shortcut_s: how long shortcuts are tried, whether they pay or not [s]; what is found depends
            on the machine. 0 for as long as they pay.
        sidestep_candidates: most sidesteps tried after the shortcuts: ways that are no shorter, but on
            which robots wait less for each other; where there are any, shortcuts are taken in the
            planned order of tasks, too, and what ends sooner is kept. ``auto`` tries them where
            robots only go to goals, and none where something is built.
        deviation: by skill, how far the flange, and with it the tool and what it holds, may be from
            the reference path while the skill is executed: force control. All is planned with it.
    """

    speed_model: SpeedModelName | None = None
    speed_rad_s: Annotated[float, Field(ge=0.01, le=100)] | None = None
    corners: Literal["smooth", "rest"] = "rest"
    step_s: Annotated[float, Field(ge=0.001, le=10)] = 0.05
    planner: Annotated[Name, AfterValidator(_registered_planner)] = "rrt-connect"
    attempts: Annotated[int, Field(ge=1, le=1000)] = 5
    assignment: Literal["auto", "paper", "search"] = "auto"
    assignment_moves: Annotated[int, Field(ge=1, le=1_000_000)] | Literal["auto"] = (
        "auto"
    )
    coordination: Literal["sequential", "synchronous"] = "sequential"
    joint_planning: Literal["conflicts", "always"] = "conflicts"
    paths: Literal["auto", "rrt"] = "auto"
    shortcut_candidates: (
        Annotated[int, Field(ge=0, le=10_000_000)] | Literal["auto"]
    ) = "auto"
    sidestep_candidates: (
        Annotated[int, Field(ge=0, le=10_000_000)] | Literal["auto"]
    ) = "auto"
    shortcut_s: Annotated[float, Field(ge=0, le=LONGEST_S)] = 0.0
    deviation: dict[Skill, PoseErrorSection] = Field(default_factory=dict)

    @property
    def l1_rad_s(self) -> float:
        """Speed of the ``l1`` model [rad/s]."""
        return 1.0 if self.speed_rad_s is None else self.speed_rad_s


class Scenario(Section):
    """A whole scenario file.

    Attributes:
        version: of the format of the file: 1.
        name: of the scenario; runs are named after it.
        description: free text.
        seed: of planning and of all random draws.
        cell: who works, and what stands around.
        assembly: what is built.
        planning: how the planner works.
        execution: how the plan is executed.
    """

    version: Literal[1]
    name: Name
    description: str = ""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    cell: CellSection
    assembly: AnyAssembly
    planning: PlanningSection = PlanningSection()
    execution: ExecutionSection = ExecutionSection()
    if not TYPE_CHECKING:
        for _name, _section in SECTIONS.load_all().items():
            __annotations__[_name] = Annotated[
                _section | None, Field(description=_section.purpose)
            ]
            vars()[_name] = None

    @property
    def checks_off(self) -> tuple[dict[str, str], ...]:
        """The checks that the file switches off: each with its ``key``, and what it would ``check``."""
        return tuple(
            {
                "key": ".".join(map(str, (*path, key))),
                "check": docstring_attributes(type(section))[key],
            }
            for path, section in iterate_nested(self)
            if isinstance(section, Section)
            for key in type(section).model_fields
            if key.split("_")[0] == "check" and getattr(section, key) is False
        )

    @model_validator(mode="after")
    def _with_processes(self) -> Scenario:
        """Spell out what skills take where ``execution.skills`` says nothing.

        Processes say it themselves. In assemblies of parts skills take their motions and what tools
        take to close and to open, elsewhere the packaged times.
        """
        own: dict[str, AnyDuration] = {
            name: duration
            for name, duration in self.processes.items()
            if duration is not None
        }
        own |= self.kind.default_durations()
        if own.keys() <= self.execution.skills.keys():
            return self
        skills = {**own, **self.execution.skills}
        execution = self.execution.model_copy(update={"skills": skills})
        return self.model_copy(update={"execution": execution})

    @property
    def kind(self) -> AssemblyKind:
        """The kind of the assembly."""
        return assembly_kind(self.assembly)

    @property
    def speed_model(self) -> SpeedModelName:
        """Speed model of the plan: that of the planning section, or else the default of the kind."""
        return self.planning.speed_model or self.kind.default_speed_model

    @property
    def processes(self) -> Mapping[str, AnyDuration | None]:
        """The processes that the assembly names, each with the duration that it gives."""
        return self.kind.processes()

    @property
    def tool_durations(self) -> tuple[SkillOverride, ...]:
        """How long it takes to leave and to take tools, where ``execution.skills`` does not say."""
        racks = {name: tool.rack for name, tool in self.cell.tools.items() if tool.rack}
        return tuple(
            SkillOverride(skill=skill, object=name, duration=rack.change_time)
            for skill in (TaskKind.LEAVE_TOOL, TaskKind.TAKE_TOOL)
            if skill not in self.execution.skills
            for name, rack in racks.items()
        )

    @property
    def actuations(self) -> Mapping[ActuationKey, DurationModel]:
        """How long tools take to close and to open, by act, robot and tool."""
        return self.kind.actuations(self.cell)

    @model_validator(mode="after")
    def _paths_of_constructions(self) -> Scenario:
        if self.planning.paths != "auto" and not self.kind.space_time:
            raise ValueError(
                f"planning.paths says how the paths of a construction are found: leave it out"
                f" for kind {self.assembly.kind!r}, or set it to 'auto'"
            )
        return self

    @model_validator(mode="after")
    def _slots_to_execute(self) -> Scenario:
        if self.execution.policy != "synchronous":
            return self
        if self.planning.coordination != "synchronous":
            raise ValueError(
                "policy 'synchronous' needs a plan in slots: set the planning's"
                " coordination to 'synchronous'"
            )
        tried = self.planning.shortcut_candidates not in ("auto", 0)
        if tried or self.planning.shortcut_s:
            raise ValueError(
                "policy 'synchronous' executes the slots as they were planned: leave"
                " shortcut_candidates and shortcut_s away, or choose policy 'asynchronous'"
            )
        return self


def resolve_scenario(scenario: Scenario) -> dict[str, Any]:
    """Return the scenario with every default filled in, ready for JSON, without optional sections.

    Optional sections do not affect runs.
    """
    optional = set(SECTIONS.names())
    content = scenario.model_dump(mode="json", by_alias=True, exclude=optional)
    skills = scenario.execution.skills
    for name, duration in scenario.processes.items():
        if skills.get(name) == duration:  # given by the process itself
            content["execution"]["skills"].pop(name, None)
    return content


def restore_scenario(content: Mapping[str, Any]) -> Scenario:
    """Return the scenario whose resolved content is given.

    Raises:
        ScenarioError: it is not valid; names the first invalid place and the reason.
    """
    try:
        # As JSON: sections are strict, and a list is a tuple only there.
        return Scenario.model_validate_json(json.dumps(content))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        text = f"{place}: {first['msg']}" if place else str(first["msg"])
        raise ScenarioError(text) from None
