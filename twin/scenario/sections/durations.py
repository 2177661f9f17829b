"""How long a skill takes: the distributions a scenario file can name, by ``kind``.

What one value or a few together can be is checked here. Whether a distribution can exist at all,
which may depend on a file of measured times, is checked by building it (``twin.scenario.duration_checks``).
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from twin.scenario.sections.base import Section

Skill = Literal[
    "pick",
    "place-down",
    "place-up",
    "handover",
    "support-bottom",
    "support-top",
]

Seconds = Annotated[float, Field(ge=0, le=1e6)]
PositiveSeconds = Annotated[float, Field(gt=0, le=1e6)]
Factor = Annotated[float, Field(ge=0.001, le=1000)]
Shape = Annotated[float, Field(ge=0.1, le=1e6)]


class AnyDuration(Section):
    """What all distributions have.

    Attributes:
        scale: every duration is multiplied with it.
    """

    scale: Factor = 1.0


class FixedDuration(AnyDuration):
    """Always the same."""

    kind: Literal["fixed"]
    value_s: Seconds


class UniformDuration(AnyDuration):
    """Evenly spread between two bounds."""

    kind: Literal["uniform"]
    low_s: Seconds
    high_s: Seconds

    @model_validator(mode="after")
    def _ordered(self) -> UniformDuration:
        if self.low_s > self.high_s:
            raise ValueError("low_s must not exceed high_s")
        return self


class _PeakedDuration(AnyDuration):
    """Two bounds and the most likely duration between them."""

    low_s: Seconds
    mode_s: Seconds
    high_s: Seconds

    @model_validator(mode="after")
    def _ordered(self) -> _PeakedDuration:
        if not self.low_s <= self.mode_s <= self.high_s or self.low_s == self.high_s:
            raise ValueError("low_s <= mode_s <= high_s expected, low_s below high_s")
        return self


class TriangularDuration(_PeakedDuration):
    """Rises in a straight line to the most likely duration, and falls so."""

    kind: Literal["triangular"]


class PertDuration(_PeakedDuration):
    """As triangular, but smooth and with less weight on the bounds."""

    kind: Literal["pert"]


class NormalDuration(AnyDuration):
    """Normal, cut off at 0 or at bounds of its own.

    Attributes:
        mean_s, sd_s: before it is cut off [s].
        low_s, high_s: shortest and longest duration; no longest one when not given [s].
    """

    kind: Literal["normal"]
    mean_s: Annotated[float, Field(ge=-1e6, le=1e6)]
    sd_s: PositiveSeconds
    low_s: Seconds = 0.0
    high_s: PositiveSeconds | None = None


class LognormalDuration(AnyDuration):
    """Skewed to the right, given by its median and 95th percentile, or by mean and cv.

    Attributes:
        median_s, p95_s: half and 95 % of the durations are shorter [s].
        mean_s, cv: expected duration [s], and standard deviation over mean.
    """

    kind: Literal["lognormal"]
    median_s: PositiveSeconds | None = None
    p95_s: PositiveSeconds | None = None
    mean_s: PositiveSeconds | None = None
    cv: Factor | None = None

    @model_validator(mode="after")
    def _one_pair(self) -> LognormalDuration:
        _require_pair(self, ("median_s", "p95_s"), ("mean_s", "cv"))
        if (self.p95_s or 0.0) < (self.median_s or 0.0):
            raise ValueError("p95_s must not be less than median_s")
        return self


class ExponentialDuration(AnyDuration):
    """Without memory: short ones are most likely, some are very long."""

    kind: Literal["exponential"]
    mean_s: Seconds


class GammaDuration(AnyDuration):
    """Skewed to the right, given by shape and scale, or by mean and cv.

    Attributes:
        shape, scale_s: the mean is their product.
        mean_s, cv: expected duration [s], and standard deviation over mean.
    """

    kind: Literal["gamma"]
    shape: Shape | None = None
    scale_s: PositiveSeconds | None = None
    mean_s: PositiveSeconds | None = None
    cv: Factor | None = None

    @model_validator(mode="after")
    def _one_pair(self) -> GammaDuration:
        _require_pair(self, ("shape", "scale_s"), ("mean_s", "cv"))
        return self


class WeibullDuration(AnyDuration):
    """Skewed to the right for small shapes, to the left for shapes above 3.6.

    Attributes:
        shape: the greater, the narrower.
        scale_s: 63 % of the durations are shorter [s].
    """

    kind: Literal["weibull"]
    shape: Shape
    scale_s: PositiveSeconds


class EmpiricalDuration(AnyDuration):
    """Drawn from measured times: a column of a CSV file, relative to the scenario file."""

    kind: Literal["empirical"]
    csv: str
    column: str = "duration_s"


class PackagedDuration(AnyDuration):
    """Drawn from the synthetic timings that ship with the package, those of a skill."""

    kind: Literal["packaged"]
    skill: Skill


class ShiftedDuration(AnyDuration):
    """Another distribution and a time that never varies.

    Attributes:
        model: the part that varies.
        offset_s: added to it; negative where the shortest duration leaves room for it [s].
    """

    kind: Literal["shifted"]
    model: DurationSection
    offset_s: Annotated[float, Field(ge=-1e6, le=1e6)]


class RetriesDuration(AnyDuration):
    """An attempt and, as long as attempts fail, retries; all added up.

    Attributes:
        attempt: duration of the first attempt.
        probability: that an attempt fails.
        retries: most attempts after the first; after the last the work counts as done.
        retry: duration of a retry; that of the attempt when not given.
    """

    kind: Literal["retries"]
    attempt: DurationSection
    probability: Annotated[float, Field(ge=0, lt=1)]
    retries: Annotated[int, Field(ge=0, le=20)] = 2
    retry: DurationSection | None = None


class ReferenceDuration(Section):
    """As long as the reference path of the skill takes at the speed of the robot's other motions.

    So skills are executed in the simulations of APEX-MR V-A, without force control.
    """

    kind: Literal["reference"]


_Distribution = (
    FixedDuration
    | UniformDuration
    | TriangularDuration
    | PertDuration
    | NormalDuration
    | LognormalDuration
    | ExponentialDuration
    | GammaDuration
    | WeibullDuration
    | EmpiricalDuration
    | PackagedDuration
    | ShiftedDuration
    | RetriesDuration
)

DurationSection = Annotated[_Distribution, Field(discriminator="kind")]
"""Any distribution of durations; ``kind`` says which."""

SkillSection = Annotated[_Distribution | ReferenceDuration, Field(discriminator="kind")]
"""How long a skill takes: drawn from a distribution, or that of its reference path."""

ShiftedDuration.model_rebuild()
RetriesDuration.model_rebuild()


def _require_pair(
    section: Section, first: tuple[str, str], second: tuple[str, str]
) -> None:
    """Require one of two pairs of keys, whole and alone."""
    keys = {*first, *second}
    given = {key for key in keys if getattr(section, key) is not None}
    if given not in ({*first}, {*second}):
        raise ValueError(
            f"give {first[0]} and {first[1]}, or {second[0]} and {second[1]}"
        )
