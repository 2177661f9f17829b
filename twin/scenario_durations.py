"""How long a skill takes: the distributions a scenario file can name, by ``kind``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Seconds = Annotated[float, Field(ge=0, le=1e6)]
PositiveSeconds = Annotated[float, Field(gt=0, le=1e6)]


class _Duration(BaseModel):
    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False
    )


class FixedDuration(_Duration):
    """Always the same."""

    kind: Literal["fixed"]
    value_s: Seconds


class UniformDuration(_Duration):
    """Evenly spread between two bounds."""

    kind: Literal["uniform"]
    low_s: Seconds
    high_s: Seconds

    @model_validator(mode="after")
    def _ordered(self) -> UniformDuration:
        if self.low_s > self.high_s:
            raise ValueError("low_s must not exceed high_s")
        return self


class LognormalDuration(_Duration):
    """Skewed to the right, given by its median and 95th percentile."""

    kind: Literal["lognormal"]
    median_s: PositiveSeconds
    p95_s: PositiveSeconds

    @model_validator(mode="after")
    def _ordered(self) -> LognormalDuration:
        if self.p95_s < self.median_s:
            raise ValueError("p95_s must not be less than median_s")
        return self


class EmpiricalDuration(_Duration):
    """Drawn from measured times: a column of a CSV file, relative to the scenario file."""

    kind: Literal["empirical"]
    csv: str
    column: str = "duration_s"


DurationSection = Annotated[
    FixedDuration | UniformDuration | LognormalDuration | EmpiricalDuration,
    Field(discriminator="kind"),
]
