"""Parts that are joined to each other, and parts that are pressed into each other."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from twin.scenario.document.section import Name, Section, Two, with_tuples


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
