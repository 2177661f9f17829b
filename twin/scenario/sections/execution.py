"""Execution section of a scenario file: policy, durations, messages and disturbances."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticKnownError, core_schema

from planning.bounds import LONGEST_S
from planning.cell.workcell import Workcell
from planning.errors import ScenarioError
from planning.transforms import Transform
from twin.document.section import Name, Section
from twin.document.yaml_text import KeyPath
from twin.durations.bounded import Fixed
from twin.durations.composed import AnyDuration, SkillOverride
from twin.durations.kinds import DurationKinds
from twin.durations.model import DurationModel, Skill
from twin.registry import POLICIES
from twin.scenario.sections.shapes import PoseSection
from twin.uncertainty.disturbances import (
    Disturbances,
    LatePart,
    OrderChange,
    Outage,
    Probability,
)

Latency = Annotated[float, Field(ge=0, le=3600)]


class ReferenceDuration(Section):
    """As long as the reference path of the skill takes at the speed of the robot's other motions.

    So skills are executed in the simulations of APEX-MR V-A, without force control.
    """

    kind: Literal["reference"]


SkillSection = Annotated[
    DurationModel | ReferenceDuration, DurationKinds((ReferenceDuration,))
]
"""Duration of a skill: drawn from a distribution, or that of its reference path."""


class _RegisteredPolicy:
    """Metadata of a key whose value is the name of a dispatch policy."""

    def __get_pydantic_core_schema__(
        self, _source: Any, _handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(_registered_policy)

    def __get_pydantic_json_schema__(
        self, _core: CoreSchema, _handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return {"enum": list(POLICIES.names()), "type": "string"}


def _registered_policy(name: object) -> object:
    """Return the name of a policy; one that is not registered is refused as of a fixed list."""
    if name in POLICIES:
        return name
    *others, last = map(repr, POLICIES.names())
    expected = f"{', '.join(others)} or {last}"
    raise PydanticKnownError("literal_error", {"expected": expected})


PolicyName = Annotated[str, _RegisteredPolicy()]
"""Name of a dispatch policy of ``twin.registry.POLICIES``."""


class WindowsSection(Section):
    """How windows of time between steps are kept while the plan is executed.

    Attributes:
        hold: the work of a step that opens a window does not begin before the later step would be
            in time with this probability, by the forecast; it waits for no longer than until all that
            the later step needs of others is done. 0 holds nothing back.
    """

    hold: Annotated[float, Field(ge=0, le=0.9999)] = 0.0


class StepWindowSection(Section):
    """How many steps ``twin operate`` plans ahead, in place of all at once.

    Attributes:
        steps: that are planned at a time; of a line whole products with at least so many.
        least: when so many of them, or fewer, are not begun, the next ones are planned.
    """

    steps: Annotated[int, Field(ge=1, le=100_000)]
    least: Annotated[int, Field(ge=0, le=100_000)] = 3

    @property
    def first(self) -> int:
        """Number of steps that are planned before anybody moves: so few that more come next at once."""
        return min(self.steps, self.least + 1)


class AskSection(Section):
    """A person who is asked before a step is given up for want of objects, or after many failures.

    Attributes:
        answer_s: how long the person takes [s].
        answer: distribution of that time, in place of ``answer_s``.
        helps: probability that the person brings what is asked for, or sees to what fails.
        times: most times that somebody is asked for one step.
    """

    answer_s: Annotated[float, Field(ge=0, le=LONGEST_S)] = 60.0
    answer: AnyDuration | None = None
    helps: Probability = 1.0
    times: Annotated[int, Field(ge=1, le=1000)] = 3

    not_both = (("answer_s", "answer"),)

    @property
    def model(self) -> DurationModel:
        """Distribution of the time that the person takes."""
        return self.answer or Fixed(value_s=self.answer_s)


class BinSection(Section):
    """A bin into which robots drop parts that are scrapped.

    Attributes:
        pose: of a part where a robot lets go of it, over the bin.
        fixture: fixture to which the pose belongs; the world when not given.
    """

    pose: PoseSection
    fixture: Name | None = None

    def pose_in(self, cell: Workcell) -> Transform:
        """Return the pose of a part where a robot lets go of it, in the world."""
        base = [item.pose for item in cell.fixtures if item.name == self.fixture]
        return base[0] @ self.pose.transform() if base else self.pose.transform()


class RecoverySection(Section):
    """What ``twin operate`` does when a skill has failed for good or a robot is out.

    Attributes:
        planning_s: how long planning takes in the simulation, for which all others go on [s].
        shortcuts: candidates tried on each new plan.
        remove_s: how long a person takes to take what a robot holds that has nowhere to go [s].
        remove: distribution of that time, in place of ``remove_s``.
        bin: into which a robot drops a part that is scrapped, or a person, if none can; ``person``: a person takes
            each from where it lies; they stay there when not given.
        again: how often a skill is planned anew with what it was to be done with, before its step is
            given up.
        ask: who is asked before that, and before a step is given up of which nothing is left; None for nobody.
    """

    planning_s: Annotated[float, Field(ge=0, le=3600)] = 1.0
    shortcuts: Annotated[int, Field(ge=0, le=1_000_000)] = 60
    remove_s: Annotated[float, Field(ge=0, le=3600)] = 10.0
    remove: AnyDuration | None = None
    bin: BinSection | Literal["person"] | None = None
    again: Annotated[int, Field(ge=0, le=100)] = 3
    ask: AskSection | None = None

    not_both = (("remove_s", "remove"),)


class ExecutionSection(Disturbances):
    """Execution of the plan: policy, durations, messages and disturbances.

    Attributes:
        policy: ``asynchronous`` releases a node as soon as what it waits for is complete;
            ``sequential`` runs one robot at a time, and machines meanwhile; ``synchronous`` runs a plan made in slots
            slot by slot; in ``open-loop`` every robot follows the planned clock and nobody waits.
        queue_depth: nodes that a robot may have been given ahead; default: 1, and as many as are
            safe with speed_model limits, where robots brake before the last one they were given.
        latency_s: time that a message takes between a robot and the dispatcher [s].
        report_latency_s: the same from robot to dispatcher only [s].
        release_latency_s: the same from dispatcher to robot only [s].
        skills: duration models by skill, of all that it takes; where not given, a process takes
            what it says itself, a skill of an assembly of parts its motions and what the tool takes
            to close or to open, and skills elsewhere the packaged synthetic timings.
        skill_overrides: exceptions from ``skills`` for robots and types of objects.
        windows: how windows of time between steps are kept.
        outages: robots and machines that stop for good, for ``twin operate``.
        late: parts that are not there in time, which nobody knows beforehand, for ``twin operate``.
        changes: of what is wanted, for ``twin operate``.
        recovery: what is done then, and when a skill has failed for good.
        window: how many steps ``twin operate`` plans ahead; by default all of them, or few at a time of a
            large assembly of bricks; ``all`` for all of them.
    """

    policy: PolicyName = "asynchronous"
    queue_depth: Annotated[int, Field(ge=1, le=100_000)] | None = None
    latency_s: Latency = 0.0
    report_latency_s: Latency | None = None
    release_latency_s: Latency | None = None
    skills: dict[Skill, SkillSection] = Field(default_factory=dict)
    skill_overrides: tuple[SkillOverride, ...] = ()
    windows: WindowsSection = WindowsSection()
    outages: tuple[Outage, ...] = ()
    late: tuple[LatePart, ...] = ()
    changes: tuple[OrderChange, ...] = ()
    recovery: RecoverySection = RecoverySection()
    window: StepWindowSection | Literal["all"] | None = None

    @property
    def step_window(self) -> StepWindowSection | None:
        """The rolling planning window; None to plan all steps at once."""
        return None if self.window == "all" else self.window

    def skill_models(self, folder: Path = Path()) -> dict[str, DurationModel]:
        """Return the duration model of every skill, without exceptions.

        Skills that take as long as their reference path have none.

        Args:
            folder: where relative paths start, that of the scenario's file.

        Raises:
            ScenarioError: a file of measured times cannot be read.
        """
        return {
            skill: duration.located(folder)
            for skill, duration in self.skills.items()
            if isinstance(duration, DurationModel)
        }

    def skill_exceptions(self, folder: Path = Path()) -> tuple[SkillOverride, ...]:
        """Return the exceptions from ``skill_models`` with their files read.

        Args:
            folder: where relative paths start, that of the scenario's file.

        Raises:
            ScenarioError: a file of measured times cannot be read.
        """
        return tuple(item.located(folder) for item in self.skill_overrides)

    def named_robots(self) -> Iterator[tuple[KeyPath, str]]:
        """Yield the robots that disturbances happen to, each with its key in the section."""
        for name in self.speed.robots:
            yield ("speed", "robots", name), name
        if self.breakdowns is not None:
            for i, name in enumerate(self.breakdowns.robots or ()):
                yield ("breakdowns", "robots", i), name
        for i, stop in enumerate(self.emergency_stops):
            if stop.robot is not None:
                yield ("emergency_stops", i, "robot"), stop.robot

    def named_workers(self) -> Iterator[tuple[KeyPath, str]]:
        """Yield the robots and machines with planned stops and shifts, each with its key in the section."""
        for i, stop in enumerate(self.planned_stops):
            for k, name in enumerate(stop.who or ()):
                yield ("planned_stops", i, "who", k), name
        shifts = () if self.calendar is None else self.calendar.shifts
        for i, shift in enumerate(shifts):
            for k, name in enumerate(shift.who or ()):
                yield ("calendar", "shifts", i, "who", k), name

    def disturbances(
        self, robots: tuple[str, ...], folder: Path = Path()
    ) -> Disturbances:
        """Return the disturbances with their files read.

        Args:
            robots: all robots of the cell.
            folder: where relative paths start, that of the scenario's file.

        Raises:
            ScenarioError: a file of measured times cannot be read, or there is no such robot.
        """
        for _, name in self.named_robots():
            if name not in robots:
                raise ScenarioError(f"disturbances: no robot {name!r}", choices=robots)
        return self.located(folder)

    def needs_event_engine(self) -> list[str]:
        """Return why only the event engine can run a scenario, empty if any engine can.

        Completion times are longest paths in the graph only if messages take no time (then the
        depth of the queues makes no difference) and nothing happens at times of the run's clock.
        Policies and tasks that fail for good are left to the caller.
        """
        slow = {}
        for key, seconds in (("report", self.report_s), ("release", self.release_s)):
            own = getattr(self, f"{key}_latency_s") is not None
            slow[f"{key}_latency_s" if own else "latency_s"] = seconds
        reasons = [
            f"{name} is {seconds:g}: messages take time"
            for name, seconds in slow.items()
            if seconds > 0
        ]
        if self.emergency_stops:
            reasons.append("emergency_stops happen at times of the run's clock")
        if self.plans_stops:
            reasons.append("planned stops and shifts are at times of the run's clock")
        if self.breaks_by_clock:
            reasons.append("breakdowns happen at times of the run's clock")
        return reasons

    def describe_unforeseen_events(self) -> list[str]:
        """Return what is only planned for once it has happened, at times of the run's clock, in words."""
        sections = {"outages": self.outages, "late": self.late, "changes": self.changes}
        return [
            f"{key}: happens at times of the run's clock"
            for key, own in sections.items()
            if own
        ]

    @property
    def rejecting(self) -> tuple[str, ...]:
        """Processes that may fail, and after which a part is worked at again or scrapped."""
        found = {k: own for k, own in self.failures.items() if own.then != "again"}
        return tuple(k for k, own in found.items() if own.probability or own.parts)

    def may_be_replanned(self) -> bool:
        """Tell whether anything may happen that requires replanning."""
        return bool(self.failures) or bool(self.describe_unforeseen_events())

    @property
    def report_s(self) -> float:
        """Time that a message takes from a robot to the dispatcher [s]."""
        own = self.report_latency_s
        return self.latency_s if own is None else own

    @property
    def release_s(self) -> float:
        """Time that a message takes from the dispatcher to a robot [s]."""
        own = self.release_latency_s
        return self.latency_s if own is None else own
