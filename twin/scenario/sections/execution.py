"""How a plan is executed: the ``execution`` section of a scenario file."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

from pydantic import Field, field_validator, model_validator

from twin.scenario.sections.base import Name, Section
from twin.scenario.sections.disturbances import (
    BreakdownsSection,
    EmergencyStopSection,
    FailureSection,
    SpeedSection,
    StallsSection,
)
from twin.scenario.sections.durations import (
    DurationSection,
    PackagedDuration,
    Skill,
    SkillSection,
)

Latency = Annotated[float, Field(ge=0, le=3600)]


class SkillOverride(Section):
    """An exception: a skill done by one robot, to one type of object, or both.

    The exception that names robot and object is the strongest, then the one that names the
    robot, then the one that names the object.

    Attributes:
        skill: which skill.
        robot: who does it; everyone when not given.
        object: type of what it is done to, such as ``2x4``; anything when not given.
        duration: how long it then takes.
    """

    skill: Skill
    robot: Name | None = None
    object: str | None = None
    duration: DurationSection

    @model_validator(mode="after")
    def _names_something(self) -> SkillOverride:
        if self.robot is None and self.object is None:
            raise ValueError("name a robot, an object or both; else use 'skills'")
        return self


class ExecutionSection(Section):
    """How the plan is executed.

    Attributes:
        policy: ``asynchronous`` releases a node as soon as what it waits for is complete;
            ``sequential`` runs one task at a time; ``synchronous`` runs a plan made in slots
            slot by slot; in ``open-loop`` every robot follows the planned clock and nobody waits.
        queue_depth: nodes that a robot may have been given ahead.
        latency_s: time that a message takes between a robot and the dispatcher [s].
        report_latency_s: the same from robot to dispatcher only [s].
        release_latency_s: the same from dispatcher to robot only [s].
        skills: duration models by skill; the packaged synthetic timings where not given.
        skill_overrides: exceptions from ``skills`` for robots and types of objects.
        speed: speed factors of the robots' controllers.
        jitter: distribution of what every node takes longer.
        stalls: random standstills.
        breakdowns: of robots.
        failures: of attempts at a skill, by skill.
        emergency_stops: at given times.
    """

    policy: Literal["asynchronous", "sequential", "synchronous", "open-loop"] = (
        "asynchronous"
    )
    queue_depth: Annotated[int, Field(ge=1, le=100_000)] = 1
    latency_s: Latency = 0.0
    report_latency_s: Latency | None = None
    release_latency_s: Latency | None = None
    skills: dict[Skill, SkillSection] = Field(
        default_factory=dict, validate_default=True
    )
    skill_overrides: tuple[SkillOverride, ...] = ()
    speed: SpeedSection = SpeedSection()
    jitter: DurationSection | None = None
    stalls: StallsSection = StallsSection()
    breakdowns: BreakdownsSection | None = None
    failures: dict[Skill, FailureSection] = Field(default_factory=dict)
    emergency_stops: tuple[EmergencyStopSection, ...] = ()

    @field_validator("skills")
    @classmethod
    def _all_skills(cls, given: dict[Skill, SkillSection]) -> dict[Skill, SkillSection]:
        """Spell out what is drawn from where the file says nothing."""
        names: tuple[Skill, ...] = get_args(Skill)
        packaged: dict[Skill, SkillSection] = {
            name: PackagedDuration(kind="packaged", skill=name) for name in names
        }
        return {**packaged, **given}
