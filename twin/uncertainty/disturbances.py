"""Disturbances of a run, as sections of a scenario file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self, TypeVar

from pydantic import Field, model_validator

from planning.bounds import LONGEST_S
from planning.cell.workcell import PlacedRobot, PoseError, Workcell
from planning.errors import ScenarioError
from twin.document.section import Name, PairOf, Section, Several
from twin.durations.bounded import Fixed, Uniform
from twin.durations.composed import AnyDuration
from twin.durations.lifetimes import Exponential
from twin.durations.lognormal import Lognormal
from twin.durations.model import DurationModel, Factor, Seconds, Skill
from twin.uncertainty.base_errors import PoseErrorSection
from twin.uncertainty.working_hours import Calendar, PlannedStop

_SHORTEST_MTBF_S = 0.1
"""Shortest mean time between failures [s]."""

Probability = Annotated[float, Field(ge=0, le=1)]
"""Probability of an event."""


B = TypeVar("B", bound="MachineBreakdowns")


class _FactorSection(Section):
    """A distribution of a factor, with the keys of one of durations but for the unit."""

    _model: ClassVar[type[DurationModel]]

    @property
    def model(self) -> DurationModel:
        """The distribution; models do not care what the unit is."""
        given = self.model_dump(exclude={"kind"})
        return self._model(**{f"{key}_s": value for key, value in given.items()})


class FixedFactor(_FactorSection):
    """A constant factor.

    Attributes:
        value: the factor.
    """

    _model: ClassVar = Fixed
    kind: Literal["fixed"]
    value: Factor


class UniformFactor(_FactorSection):
    """Uniform distribution between two bounds.

    Attributes:
        low, high: least and greatest factor.
    """

    _model: ClassVar = Uniform
    kind: Literal["uniform"]
    low: Factor
    high: Factor

    @model_validator(mode="after")
    def _ordered(self) -> UniformFactor:
        if self.low > self.high:
            raise ValueError("low must not exceed high")
        return self


class LognormalFactor(_FactorSection):
    """Lognormal distribution, given by its median and 95th percentile.

    Attributes:
        median: half of the factors are less.
        p95: 95 % of the factors are less.
    """

    _model: ClassVar = Lognormal
    kind: Literal["lognormal"]
    median: Factor
    p95: Factor

    @model_validator(mode="after")
    def _ordered(self) -> LognormalFactor:
        if self.p95 < self.median:
            raise ValueError("p95 must not be less than median")
        return self


AnyFactor = Annotated[
    FixedFactor | UniformFactor | LognormalFactor, Field(discriminator="kind")
]
"""Distribution of a factor without a unit."""


class Speed(Section):
    """Speed factors of the robots' controllers: motions take planned time / factor.

    Attributes:
        factor: of every robot that is not under ``robots``; drawn once a transit.
        robots: of single robots.
    """

    factor: AnyFactor | None = None
    robots: dict[Name, AnyFactor] = Field(default_factory=dict)

    def model_of(self, robot: str) -> DurationModel | None:
        """Return the distribution of a robot's factor, None where it is 1."""
        factor = self.robots.get(robot, self.factor)
        return None if factor is None else factor.model


class Stalls(Section):
    """Standstills at random times, as when a robot waits for a person.

    Attributes:
        count_per_robot: how many each robot suffers, one at each of so many of its nodes.
        duration_s: shortest and longest [s].
        rate_per_h: stalls an hour of a robot's busy time, besides those counted.
        duration: distribution of a stall, in place of ``duration_s``.
    """

    count_per_robot: Annotated[int, Field(ge=0, le=100_000)] = 0
    duration_s: PairOf[Annotated[float, Field(ge=0, le=1e9)]] = (1.0, 20.0)
    rate_per_h: Annotated[float, Field(ge=0, le=36_000)] = 0.0
    duration: AnyDuration | None = None

    @model_validator(mode="after")
    def _ordered(self) -> Stalls:
        if self.duration_s[0] > self.duration_s[1]:
            raise ValueError("duration_s is [shortest, longest]")
        return self

    @property
    def happen(self) -> bool:
        """True if there are any."""
        return bool(self.count_per_robot or self.rate_per_h)

    @property
    def model(self) -> DurationModel:
        """Distribution of a stall."""
        low, high = self.duration_s
        # These bounds may be greater than a distribution may have them.
        return self.duration or Uniform.model_construct(low_s=low, high_s=high)


class MachineBreakdowns(Section):
    """A machine breaks down and is repaired.

    Attributes:
        mtbf_s: mean time between failures, exponential [s]; or
        mtbf: distribution of the time between failures.
        mttr_s: mean time to repair, exponential [s]; or
        mttr: distribution of the time to repair.
        clock: what the time between failures counts: ``busy`` time of what breaks down, or all time of the
            ``run``.
    """

    mtbf_s: Annotated[float, Field(ge=0.1, le=1e9)] | None = None
    mtbf: AnyDuration | None = None
    mttr_s: Seconds | None = None
    mttr: AnyDuration | None = None
    clock: Literal["busy", "run"] = "busy"

    @model_validator(mode="after")
    def _one_of_each(self) -> MachineBreakdowns:
        for name in ("mtbf", "mttr"):
            mean, model = getattr(self, f"{name}_s"), getattr(self, name)
            if (mean is None) == (model is None):
                raise ValueError(f"give {name}_s, a mean, or {name}, a distribution")
        return self

    @property
    def between(self) -> DurationModel:
        """Distribution of the time between failures."""
        if self.mtbf is not None:
            return self.mtbf
        assert self.mtbf_s is not None
        return Exponential(mean_s=self.mtbf_s)

    @property
    def repair(self) -> DurationModel:
        """Distribution of the time to repair."""
        if self.mttr is not None:
            return self.mttr
        assert self.mttr_s is not None
        return Exponential(mean_s=self.mttr_s)

    def located(self, folder: Path) -> Self:
        """Return the same with files of measured times read.

        Raises:
            ScenarioError: a file cannot be read.
        """
        mtbf = None if self.mtbf is None else self.mtbf.located(folder)
        mttr = None if self.mttr is None else self.mttr.located(folder)
        if mtbf is not None and mtbf.mean < _SHORTEST_MTBF_S:
            raise ScenarioError(
                f"breakdowns: the mean of mtbf is {mtbf.mean:g} s, and must be {_SHORTEST_MTBF_S:g} s at least"
            )
        return self.changed(mtbf=mtbf, mttr=mttr)

    def repaired_faster(self, share: float) -> Self:
        """Return the same with times to repair reduced by a share."""
        if share >= 1.0:
            return self.changed(mttr=None, mttr_s=0.0)
        if self.mttr is not None:
            return self.changed(mttr=self.mttr.scaled(1.0 - share))
        assert self.mttr_s is not None
        return self.changed(mttr_s=(1.0 - share) * self.mttr_s)

    def affects(self, name: str, clock: Literal["busy", "run"]) -> bool:
        """Return whether something of a name breaks down by a clock."""
        return self.clock == clock


class Breakdowns(MachineBreakdowns):
    """Robots break down and are repaired.

    Attributes:
        robots: who breaks down; every robot when not given.
    """

    robots: tuple[Name, ...] | None = None

    def affects(self, name: str, clock: Literal["busy", "run"]) -> bool:
        """Return whether a robot of a name breaks down by a clock."""
        return self.clock == clock and (self.robots is None or name in self.robots)


class ReworkSection(Section):
    """What is done again when all attempts at a process have failed.

    Attributes:
        steps: names of the processes that are done again; all that was done to the part since it came to
            its place when not given.
        times: how often, in place of ``recovery.again``.
        then: what is done when it fails once more: ``scrap``, the part is given up; ``ask``, the person of
            ``recovery.ask`` is asked before.
    """

    steps: Several[Name] | None = None
    times: Annotated[int, Field(ge=1, le=100)] | None = None
    then: Literal["scrap", "ask"] = "scrap"


class SkillFailure(Section):
    """Attempts at a skill that fail.

    Attributes:
        probability: that an attempt fails.
        parts: that an attempt fails with a part for a reason of its own, such as a peg that misses its
            hole, by its name, or by ROBOT/PART.
        retries: further attempts after the first; when all fail, the task has failed.
        retry: distribution of the time until the next attempt begins; by default as long as
            the skill takes in that run.
        loses: probability that the object is lost in an attempt that fails, dropped or broken, so that
            it is not made again; of picks, places and handovers.
        slips: share of those in which it does not fall, but slips in the hand, which then brings it to a person.
        wrong: share of those of a pick in which it is a wrong part or a broken one, and stays where it lies.
        beside: share of those of a pick in which it lies beside where it was said: it is measured, and picked there.
        offset: how far: its origin is anywhere within ``m``, and it is turned about the vertical by up to ``rad``.
        then: what is done when all attempts at a process have failed, such as an inspection that rejects a part:
            ``again``; ``rework``, what was done to the part before, there, and then again; or ``scrap``, it is given up.
        rework: what is done again with ``then: rework``, how often, and what then.
    """

    probability: Probability
    parts: dict[str, Probability] = Field(default_factory=dict)
    retries: Annotated[int, Field(ge=0, le=1000)] = 2
    retry: AnyDuration | None = None
    loses: Probability = 0.0
    slips: Probability = 0.0
    wrong: Probability = 0.0
    beside: Probability = 0.0
    offset: PoseErrorSection = PoseErrorSection(m=0.005)
    then: Literal["again", "rework", "scrap"] = "again"
    rework: ReworkSection | None = None

    @model_validator(mode="after")
    def _reworks(self) -> SkillFailure:
        if self.rework is not None and self.then != "rework":
            raise ValueError("rework says what is done again: give then: rework, too")
        return self

    @property
    def named(self) -> tuple[str, ...]:
        """Names of the steps that are done again; empty for all that was done to the part."""
        return () if self.rework is None else self.rework.steps or ()

    def most(self, again: int) -> int:
        """Return how often a skill is planned again after failures, ``recovery.again`` if it does not say."""
        times = None if self.rework is None else self.rework.times
        return times or again

    def of(self, robot: str, part: str | None) -> float:
        """Return the probability that an attempt of a robot with a part fails, whatever the reason."""
        if part is None or not self.parts:
            return self.probability
        bases = [part]  # a part of a product, or one of several alike, is called NAME.1
        while "." in bases[-1] and bases[-1].rpartition(".")[2].isdigit():
            bases.append(bases[-1].rpartition(".")[0])
        names = [*(f"{robot}/{base}" for base in bases), *bases]
        own = next((self.parts[name] for name in names if name in self.parts), 0.0)
        return self.probability + (1.0 - self.probability) * own


class EmergencyStop(Section):
    """A stop at once, for a while.

    Attributes:
        robot: who stops; everyone when not given.
        at_s: when [s].
        duration_s: for how long [s].
    """

    robot: Name | None = None
    at_s: Annotated[float, Field(ge=0, le=LONGEST_S)]
    duration_s: Annotated[float, Field(gt=0, le=LONGEST_S)]


class Outage(Section):
    """A robot, or a machine that works at parts, that stops for good.

    Attributes:
        robot: who stops.
        at_s: when [s]; it is at rest at the end of what it has been told to do by then.
    """

    robot: Name
    at_s: Annotated[float, Field(ge=0, le=LONGEST_S)]


class LatePart(Section):
    """A part, or a brick in stock, that is not there at the start, as the plan has it.

    Attributes:
        part: its name.
        at_s: when it comes to where it was to be [s].
    """

    part: Name
    at_s: Annotated[float, Field(ge=0, le=LONGEST_S)]


class OrderChange(Section):
    """A change of what is wanted, which nobody knows beforehand.

    Attributes:
        at_s: when it is known [s].
        drop: steps that are not wanted any more from then on, by their numbers in the plan.
        more: how many products more are wanted, of those that are spare.
    """

    at_s: Annotated[float, Field(ge=0, le=LONGEST_S)]
    drop: tuple[Annotated[int, Field(ge=1)], ...] = ()
    more: Annotated[int, Field(ge=0, le=100_000)] = 0

    @model_validator(mode="after")
    def _changes(self) -> OrderChange:
        if not self.drop and not self.more:
            raise ValueError(
                "what is ordered differently? Give drop, steps that are not wanted any more, or more, products"
            )
        return self


class MachineDisturbances(Section):
    """What disturbs one machine; nothing by default.

    Attributes:
        breakdowns: it breaks down and is repaired.
        stalls: random standstills, such as a jam.
    """

    breakdowns: MachineBreakdowns | None = None
    stalls: Stalls = Stalls()


class Disturbances(Section):
    """Disturbances of a run; none by default.

    Attributes:
        speed: speed factors of the robots' controllers.
        jitter: distribution of what every node takes longer.
        stalls: random standstills.
        breakdowns: of robots.
        failures: of attempts at a skill, by skill.
        emergency_stops: at given times.
        planned_stops: at given times, once or repeated.
        calendar: weekly shifts.
        repair_people: number of people who repair robots and machines that break down by the clock of the run;
            as many as needed when not given.
        machines: breakdowns and stalls of machines, by name.
        base_error: how far the base of every robot may be off, drawn anew for each replication whose
            motion is audited; default: what the cell says of each.
        deviation: by skill, how far flanges may be from the reference path while it is executed, drawn
            for each execution in such replications; default: what planning says.
    """

    speed: Speed = Speed()
    jitter: AnyDuration | None = None
    stalls: Stalls = Stalls()
    breakdowns: Breakdowns | None = None
    failures: dict[Skill, SkillFailure] = Field(default_factory=dict)
    emergency_stops: tuple[EmergencyStop, ...] = ()
    planned_stops: tuple[PlannedStop, ...] = ()
    calendar: Calendar | None = None
    repair_people: Annotated[int, Field(ge=1, le=1000)] | None = None
    machines: dict[Name, MachineDisturbances] = Field(default_factory=dict)
    base_error: PoseErrorSection | None = None
    deviation: dict[Skill, PoseErrorSection] | None = None

    @model_validator(mode="after")
    def _shared_by_the_clock(self) -> Disturbances:
        if self.repair_people is None:
            return self
        named: dict[str, MachineBreakdowns | None] = {"breakdowns": self.breakdowns}
        named |= {
            f"machines.{k}.breakdowns": m.breakdowns for k, m in self.machines.items()
        }
        for key, own in named.items():
            if own is not None and own.clock == "busy":
                raise ValueError(
                    f"repair_people are shared by what breaks down by the clock: set {key}.clock: run"
                )
        return self

    @property
    def at_absolute_times(self) -> bool:
        """True if some disturbance happens at absolute times of the run's clock."""
        return bool(self.emergency_stops) or self.plans_stops or self.breaks_by_clock

    @property
    def plans_stops(self) -> bool:
        """True if robots or machines stop by plan or are off shift."""
        return bool(self.planned_stops) or self.calendar is not None

    def base_error_of(self, robot: PlacedRobot) -> PoseError:
        """Return how far the base of a robot may be off."""
        own = self.base_error
        return robot.base_error if own is None else own.planned

    def deviations_in(self, cell: Workcell) -> Mapping[str, PoseError]:
        """Return how far flanges may be from the reference path, by skill."""
        if self.deviation is None:
            return cell.deviations
        return {skill: own.planned for skill, own in self.deviation.items()}

    @property
    def breaks_by_clock(self) -> bool:
        """True if a robot or machine breaks down at times of the run's clock."""
        own = (self.breakdowns, *(item.breakdowns for item in self.machines.values()))
        return any(item is not None and item.clock == "run" for item in own)

    def with_misses(self, skill: str, misses: Mapping[str, float]) -> Disturbances:
        """Return the same and that attempts at a skill fail with some parts, where nothing else is said of these.

        Args:
            skill: the skill.
            misses: probabilities by ROBOT/PART.
        """
        if not misses:
            return self
        own = self.failures.get(skill, SkillFailure(probability=0.0))
        said = {k: p for k, p in misses.items() if k.partition("/")[2] not in own.parts}
        both = own.changed(parts={**said, **own.parts})
        return self.changed(failures={**self.failures, skill: both})

    def vary_durations(self, name: str) -> bool:
        """Return whether something of a name may take longer than its skills say, or fail, at no given time."""
        breaks = self.breakdowns
        return (
            self.speed != Speed()
            or self.jitter is not None
            or self.stalls.happen
            or (breaks is not None and breaks.affects(name, "busy"))
            or any(own.probability or own.parts for own in self.failures.values())
        )

    def of_machine(self, name: str) -> Disturbances:
        """Return what disturbs a machine: what is said of it, and failed attempts at its process."""
        own = self.machines.get(name, MachineDisturbances())
        return Disturbances().changed(
            breakdowns=own.breakdowns, stalls=own.stalls, failures=self.failures
        )

    def located(self, folder: Path) -> Disturbances:
        """Return the same with files of measured times read, and without stalls that never are.

        Args:
            folder: where relative paths start.

        Raises:
            ScenarioError: a file cannot be read.
        """

        def read(model: DurationModel | None) -> DurationModel | None:
            return None if model is None else model.located(folder)

        def happening(stalls: Stalls) -> Stalls:
            if not stalls.happen:
                return Stalls()
            return stalls.changed(duration=read(stalls.duration))

        def broken(own: B | None) -> B | None:
            return None if own is None else own.located(folder)

        return Disturbances(
            speed=self.speed,
            emergency_stops=self.emergency_stops,
            planned_stops=self.planned_stops,
            calendar=self.calendar,
            repair_people=self.repair_people,
            base_error=self.base_error,
            deviation=self.deviation,
        ).changed(
            jitter=read(self.jitter),
            breakdowns=broken(self.breakdowns),
            stalls=happening(self.stalls),
            failures={
                skill: failure.changed(retry=read(failure.retry))
                for skill, failure in self.failures.items()
            },
            machines={
                name: own.changed(
                    stalls=happening(own.stalls), breakdowns=broken(own.breakdowns)
                )
                for name, own in self.machines.items()
            },
        )
