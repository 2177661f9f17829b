"""Execution section of a scenario file: policy, durations, messages, disturbances."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

from pydantic import Field, field_validator

from twin.durations import Distribution, Packaged, Skill
from twin.scenario.document.section import Section
from twin.uncertainty.disturbances import Disturbances
from twin.uncertainty.skill_override import SkillOverride

Latency = Annotated[float, Field(ge=0, le=3600)]


class ReferenceDuration(Section):
    """As long as the reference path of the skill takes at the speed of the robot's other motions.

    So skills are executed in the simulations of APEX-MR V-A, without force control.
    """

    kind: Literal["reference"]


SkillSection = Annotated[Distribution | ReferenceDuration, Field(discriminator="kind")]
"""Duration of a skill: drawn from a distribution, or that of its reference path."""


class ExecutionSection(Disturbances):
    """Execution of the plan: policy, durations, messages and disturbances.

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

    @field_validator("skills")
    @classmethod
    def _all_skills(cls, given: dict[Skill, SkillSection]) -> dict[Skill, SkillSection]:
        """Spell out what is drawn from where the file says nothing."""
        names: tuple[Skill, ...] = get_args(Skill)
        packaged: dict[Skill, SkillSection] = {
            name: Packaged(skill=name) for name in names
        }
        return {**packaged, **given}

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
