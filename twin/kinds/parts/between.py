"""Scenario sections for press fits of two parts, and for time windows between two steps."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from planning.bounds import LONGEST_S
from twin.document.section import Name, PairOf, Section

# Time lag between two steps [s].
Lag = Annotated[float, Field(ge=0, le=LONGEST_S)]


class FitSection(Section):
    """Two parts that are pressed into each other, or a part and a fixture.

    Attributes:
        parts: names of the two.
        press_m: how deep they may be in each other in their places; of a round pin in a round hole
            it is half of what its diameter is larger.
    """

    parts: PairOf[Name]
    press_m: Annotated[float, Field(gt=0, le=0.05)]


class AfterSection(Section):
    """An earlier step, and how long after it is complete the work of this one may begin.

    The earlier step is complete with its process, or when its robot has put the part down and drawn
    back. This one begins with its process, or with the straight motion that puts its part down.

    Attributes:
        step: name of the earlier step.
        within_s: latest; any time after it when not given.
        at_least_s: earliest; at once when not given.
    """

    step: Name
    within_s: Lag | None = None
    at_least_s: Lag = 0.0

    @model_validator(mode="after")
    def _not_empty(self) -> AfterSection:
        if self.within_s is not None and self.within_s < self.at_least_s:
            raise ValueError(
                f"no time is left: within_s {self.within_s:g} is below at_least_s {self.at_least_s:g}"
            )
        return self
