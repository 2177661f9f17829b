"""Balance of an assembly in a scenario: friction, and what is joined to what."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from twin.scenario.document.section import Name, Section, Two, with_tuples


class BalanceSection(Section):
    """Assumptions under which an assembly must stand after every step.

    Attributes:
        check: whether it is looked at.
        friction: least coefficient of friction of all contacts.
        tilt_deg: by which gravity may be tilted, so that nothing stands on an edge.
    """

    check: bool = True
    friction: Annotated[float, Field(gt=0, le=10)] = 0.4
    tilt_deg: Annotated[float, Field(ge=0, le=45)] = 1.0


class JoinedSection(Section):
    """Two parts that are joined, or a part and a fixture.

    Attributes:
        parts: names of the two.
        by: name of the step that joins them, such as a process that welds; the step that places
            the later of them when not given.
        force_n: most that the joint bears along each axis; whatever comes when not given.
        torque_nm: most that it bears about each axis; whatever comes when not given.
    """

    parts: Two[Name]
    by: Name | None = None
    force_n: Annotated[float, Field(gt=0, le=1e9)] | None = None
    torque_nm: Annotated[float, Field(gt=0, le=1e9)] | None = None


def _spelt_out(joined: Any) -> Any:
    """Return a joint in full: a pair of names alone bears whatever comes."""
    own = with_tuples(joined)
    return {"parts": own} if isinstance(own, tuple) else own


JoinedParts = Annotated[
    JoinedSection,
    BeforeValidator(_spelt_out, json_schema_input_type=JoinedSection | Two[Name]),
]
"""Two names, or a section in full."""
