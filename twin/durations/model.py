"""Base class of distributions of durations: scenario section, quantiles, mean."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from planning.bounds import LATEST_S, LONGEST_S
from planning.errors import ScenarioError
from planning.transforms import Array
from twin.document.section import Name, Section

PackagedSkill = Literal[
    "pick",
    "place-down",
    "place-up",
    "handover",
    "support-bottom",
    "support-top",
]
"""Skills with timings in the package."""

Skill = Name
"""Name of a skill: a packaged one, or a process of the scenario's own."""

Seconds = Annotated[float, Field(ge=0, le=LONGEST_S)]
"""A duration that may be 0 [s]."""

PositiveSeconds = Annotated[float, Field(gt=0, le=LONGEST_S)]
"""A duration above 0 [s]."""

Factor = Annotated[float, Field(ge=0.001, le=1000)]
"""Factor of a duration, from a thousandth to a thousand."""

Shape = Annotated[float, Field(ge=0.1, le=1e6)]


def _require_kind(schema: dict[str, Any]) -> None:
    """Let a scenario file name the ``kind``, which goes without saying in Python."""
    if "kind" in schema["properties"]:
        del schema["properties"]["kind"]["default"]
        schema["required"] = ["kind", *schema.get("required", [])]


class DurationModel(Section, ABC):
    """A distribution of durations, given by its quantile function.

    One uniform makes one duration, and a greater uniform never a shorter one. So common random
    numbers and antithetic pairs (u and 1 - u) do what they should with every model. Subclasses
    have a ``kind``, and say what holds before durations are multiplied by ``scale``: ``_ppf``, ``_mean``,
    and ``_minimum`` where that is not 0. Their other attributes are keys of the section.

    Attributes:
        scale: every duration is multiplied with it.
    """

    model_config = ConfigDict(json_schema_extra=_require_kind)

    scale: Factor = 1.0

    def ppf(self, u: Array) -> Array:
        """Return the quantiles [s] of probabilities ``u`` in (0, 1), same shape."""
        return self.scale * self._ppf(u)

    @property
    def mean(self) -> float:
        """Expected duration [s].

        Raises:
            ScenarioError: it is longer than any plan may last.
        """
        mean = self.scale * self._mean()
        if not mean <= LATEST_S:
            name = type(self).__name__.lower()
            raise ScenarioError(
                f"{name}: its mean is {mean:.3g} s, and may be {LATEST_S:.0e} s at most"
            )
        return mean

    @property
    def minimum(self) -> float:
        """Greatest lower bound of the durations [s], at least 0."""
        return self.scale * self._minimum()

    def scaled(self, factor: float) -> DurationModel:
        """Return the same distribution with durations multiplied by a factor above 0."""
        return self.changed(scale=self.scale * factor)

    def located(self, folder: Path) -> DurationModel:
        """Return the model with its files read, once it is clear that it can be drawn from.

        Values are checked one by one when a section is read; whether they make a distribution
        together, which may depend on files, is checked here.

        Args:
            folder: where relative paths start.

        Raises:
            ScenarioError: a file cannot be read, there is no such distribution, or its mean is longer
                than any plan may last.
        """
        found = self._located(folder)
        _ = found.mean
        return found

    def _located(self, folder: Path) -> DurationModel:
        """Return the model with its files read; ScenarioError where there is no such distribution."""
        return self

    @abstractmethod
    def _ppf(self, u: Array) -> Array: ...

    @abstractmethod
    def _mean(self) -> float: ...

    def _minimum(self) -> float:
        return 0.0


def require_pair(
    model: DurationModel, first: tuple[str, str], second: tuple[str, str]
) -> None:
    """Require one of two pairs of fields, whole and alone; else raise a ValueError."""
    given = {key for key in (*first, *second) if getattr(model, key) is not None}
    if given not in ({*first}, {*second}):
        raise ValueError(
            f"give {first[0]} and {first[1]}, or {second[0]} and {second[1]}"
        )
