"""Disturbances of a run: what may go wrong, and how often; every number is a parameter here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from planning.errors import ScenarioError
from twin.durations import DurationModel


def _require(holds: bool, message: str) -> None:
    if not holds:
        raise ScenarioError(message)


@dataclass(frozen=True)
class RandomStalls:
    """Every robot stalls at a number of its nodes, after it started them and before it moves.

    Attributes:
        count_per_robot: nodes that stall, all of a robot's nodes where it has fewer.
        duration_s: shortest and longest stall, uniform between them [s].
        model: distribution of a stall in place of ``duration_s``.
    """

    count_per_robot: int
    duration_s: tuple[float, float] = (1.0, 20.0)
    model: DurationModel | None = None

    def __post_init__(self) -> None:
        low, high = self.duration_s
        _require(
            self.count_per_robot >= 0 and 0 <= low <= high < np.inf,
            "stalls: need count_per_robot >= 0 and 0 <= shortest <= longest "
            f"duration_s, not {self.count_per_robot} and [{low}, {high}]",
        )


@dataclass(frozen=True)
class StallRate:
    """Robots stall at random while they work, in a Poisson process of their busy time.

    Attributes:
        rate_per_h: stalls an hour of a robot's busy time, on average.
        duration: distribution of a stall.
    """

    rate_per_h: float
    duration: DurationModel

    def __post_init__(self) -> None:
        _require(
            0 <= self.rate_per_h < np.inf,
            f"stalls: rate_per_h must be at least 0, not {self.rate_per_h}",
        )


@dataclass(frozen=True)
class Breakdowns:
    """Robots break down and are repaired; both times are exponential.

    Attributes:
        mtbf_s: mean time between failures [s].
        mttr_s: mean time to repair [s].
        clock: ``busy`` counts the time in which a robot executes nodes, ``run`` all time in
            which it is not broken.
        robots: who breaks down; None for everyone.
    """

    mtbf_s: float
    mttr_s: float
    clock: Literal["busy", "run"] = "busy"
    robots: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        _require(
            0 < self.mtbf_s < np.inf and 0 <= self.mttr_s < np.inf,
            "breakdowns: need mtbf_s > 0 and mttr_s >= 0, "
            f"not {self.mtbf_s} and {self.mttr_s}",
        )

    def affects(self, robot: str) -> bool:
        """Tell whether a robot can break down."""
        return self.robots is None or robot in self.robots


@dataclass(frozen=True)
class SkillFailure:
    """An attempt at a skill can fail, and is then made again.

    Attributes:
        probability: that an attempt fails, in [0, 1].
        retries: further attempts after the first; when all fail, the task has failed.
        retry: distribution of the time that a failed attempt costs until the next one begins;
            None for the skill's own duration in that run.
    """

    probability: float
    retries: int = 2
    retry: DurationModel | None = None

    def __post_init__(self) -> None:
        _require(
            0 <= self.probability <= 1 and self.retries >= 0,
            "failures: need 0 <= probability <= 1 and retries >= 0, "
            f"not {self.probability} and {self.retries}",
        )


@dataclass(frozen=True)
class EmergencyStop:
    """One robot, or all, stop at once and go on after a while.

    Attributes:
        robot: who; None for everyone.
        at_s: when [s].
        duration_s: for how long [s].
    """

    robot: str | None
    at_s: float
    duration_s: float

    def __post_init__(self) -> None:
        _require(
            0 <= self.at_s < np.inf and 0 < self.duration_s < np.inf,
            "emergency stop: need at_s >= 0 and duration_s > 0, "
            f"not {self.at_s} and {self.duration_s}",
        )


@dataclass(frozen=True)
class Disturbances:
    """All that may go wrong in a run; nothing by default.

    Attributes:
        speed: distribution of the controller's speed factor, by robot. A motion between skills
            takes its planned time divided by the factor, drawn once a task.
        jitter: distribution of what every node takes longer; None for nothing.
        stalls: a number of stalls a robot, or None.
        stall_rate: stalls at a rate, or None.
        breakdowns: or None.
        failures: by skill.
        emergency_stops: at given times.
    """

    speed: Mapping[str, DurationModel] = field(default_factory=dict)
    jitter: DurationModel | None = None
    stalls: RandomStalls | None = None
    stall_rate: StallRate | None = None
    breakdowns: Breakdowns | None = None
    failures: Mapping[str, SkillFailure] = field(default_factory=dict)
    emergency_stops: tuple[EmergencyStop, ...] = ()

    @property
    def at_absolute_times(self) -> bool:
        """Whether something happens at times of the run's clock, whatever is under way then."""
        by_clock = self.breakdowns is not None and self.breakdowns.clock == "run"
        return bool(self.emergency_stops) or by_clock
