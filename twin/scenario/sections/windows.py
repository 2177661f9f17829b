"""Windows of time between steps: how they are said, and what is done to keep them."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from twin.scenario.document.section import Name, Section

Lag = Annotated[float, Field(ge=0, le=1e6)]


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
