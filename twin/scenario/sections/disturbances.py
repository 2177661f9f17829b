"""What may go wrong when a plan is executed: the sections of a scenario file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from twin.scenario.sections.base import Name, Section
from twin.scenario.sections.durations import DurationSection

Factor = Annotated[float, Field(ge=0.001, le=1000)]


class FixedFactor(Section):
    """Always the same factor."""

    kind: Literal["fixed"]
    value: Factor


class UniformFactor(Section):
    """Evenly spread between two bounds."""

    kind: Literal["uniform"]
    low: Factor
    high: Factor

    @model_validator(mode="after")
    def _ordered(self) -> UniformFactor:
        if self.low > self.high:
            raise ValueError("low must not exceed high")
        return self


class LognormalFactor(Section):
    """Skewed to the right, given by its median and 95th percentile."""

    kind: Literal["lognormal"]
    median: Factor
    p95: Factor

    @model_validator(mode="after")
    def _ordered(self) -> LognormalFactor:
        if self.p95 < self.median:
            raise ValueError("p95 must not be less than median")
        return self


FactorSection = Annotated[
    FixedFactor | UniformFactor | LognormalFactor, Field(discriminator="kind")
]
"""Distribution of a factor without a unit."""


class SpeedSection(Section):
    """Speed factors of the robots' controllers: motions take planned time / factor.

    Attributes:
        factor: of every robot that is not under ``robots``; drawn once a transit.
        robots: of single robots.
    """

    factor: FactorSection | None = None
    robots: dict[Name, FactorSection] = Field(default_factory=dict)


class StallsSection(Section):
    """Standstills at random times, as when a robot waits for a person.

    Attributes:
        count_per_robot: how many each robot suffers.
        duration_s: shortest and longest [s].
        rate_per_h: stalls an hour of a robot's busy time, besides those counted.
        duration: distribution of a stall, in place of ``duration_s``.
    """

    count_per_robot: Annotated[int, Field(ge=0, le=100_000)] = 0
    duration_s: Annotated[
        tuple[Annotated[float, Field(ge=0)], ...], Field(min_length=2, max_length=2)
    ] = (1.0, 20.0)
    rate_per_h: Annotated[float, Field(ge=0, le=36_000)] = 0.0
    duration: DurationSection | None = None

    @model_validator(mode="after")
    def _ordered(self) -> StallsSection:
        if self.duration_s[0] > self.duration_s[1]:
            raise ValueError("duration_s is [shortest, longest]")
        return self


class BreakdownsSection(Section):
    """Robots break down and are repaired; both times are exponential.

    Attributes:
        mtbf_s: mean time between failures [s].
        mttr_s: mean time to repair [s].
        clock: what ``mtbf_s`` counts: ``busy`` time of the robot, or all time of the ``run``.
        robots: who breaks down; everyone when not given.
    """

    mtbf_s: Annotated[float, Field(gt=0, le=1e9)]
    mttr_s: Annotated[float, Field(ge=0, le=1e6)]
    clock: Literal["busy", "run"] = "busy"
    robots: tuple[Name, ...] | None = None


class FailureSection(Section):
    """Attempts at a skill that fail.

    Attributes:
        probability: that an attempt fails.
        retries: further attempts after the first; when all fail, the task has failed.
        retry: distribution of the time until the next attempt begins; by default as long as
            the skill takes in that run.
    """

    probability: Annotated[float, Field(ge=0, le=1)]
    retries: Annotated[int, Field(ge=0, le=1000)] = 2
    retry: DurationSection | None = None


class EmergencyStopSection(Section):
    """A stop at once, for a while.

    Attributes:
        robot: who stops; everyone when not given.
        at_s: when [s].
        duration_s: for how long [s].
    """

    robot: Name | None = None
    at_s: Annotated[float, Field(ge=0, le=1e6)]
    duration_s: Annotated[float, Field(gt=0, le=1e6)]
