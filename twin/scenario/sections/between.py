"""What is said between two parts or two steps: parts that are joined or pressed into each other, and windows of time."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field, model_validator

from planning.bounds import LONGEST_S
from twin.document.section import Name, Section, Two, with_tuples


class JoinedSection(Section):
    """Two parts that are joined, or a part and a fixture.

    Attributes:
        parts: names of the two.
        by: name of the step that joins them, such as a process that welds; the step that places
            the later of them when not given.
        force_n: most that the joint bears along each axis; whatever comes when not given.
        torque_nm: most that it bears about each axis; whatever comes when not given.
        gap_m: room between the two, such as of a connector that is no part, beside ``touch_m``.
    """

    parts: Two[Name]
    by: Name | None = None
    gap_m: Annotated[float, Field(ge=0, le=1)] = 0.0
    force_n: Annotated[float, Field(gt=0, le=1e9)] | None = None
    torque_nm: Annotated[float, Field(gt=0, le=1e9)] | None = None


class FitSection(Section):
    """Two parts that are pressed into each other, or a part and a fixture.

    Attributes:
        parts: names of the two.
        press_m: how deep they may be in each other in their places; of a round pin in a round hole
            it is half of what its diameter is larger.
    """

    parts: Two[Name]
    press_m: Annotated[float, Field(gt=0, le=0.05)]


def _joint_spelt_out(joined: Any) -> Any:
    """Return a joint in full: a pair of names alone bears whatever comes."""
    own = with_tuples(joined)
    return {"parts": own} if isinstance(own, tuple) else own


JoinedParts = Annotated[
    JoinedSection,
    BeforeValidator(_joint_spelt_out, json_schema_input_type=JoinedSection | Two[Name]),
]
"""Two names, or a section in full."""


Lag = Annotated[float, Field(ge=0, le=LONGEST_S)]


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


class WindowsSection(Section):
    """How windows of time between steps are kept while the plan is executed.

    Attributes:
        hold: the work of a step that opens a window does not begin before the later step would be
            in time with this probability, by the forecast; it waits for no longer than until all that
            the later step needs of others is done. 0 holds nothing back.
    """

    hold: Annotated[float, Field(ge=0, le=0.9999)] = 0.0
