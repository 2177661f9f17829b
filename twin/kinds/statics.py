"""Scenario sections for static equilibrium: joints between parts, and the balance check after every step."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from twin.document.section import Name, PairOf, Section, with_tuples
from twin.document.validation import Problems
from twin.document.yaml_text import KeyPath


class BalanceSection(Section):
    """Assumptions under which an assembly must stand after every step.

    Attributes:
        check: whether everything must stand after every step.
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
        gap_m: room between the two, such as of a connector that is no part, beside ``touch_m``.
    """

    parts: PairOf[Name]
    by: Name | None = None
    gap_m: Annotated[float, Field(ge=0, le=1)] = 0.0
    force_n: Annotated[float, Field(gt=0, le=1e9)] | None = None
    torque_nm: Annotated[float, Field(gt=0, le=1e9)] | None = None


def _joint_spelt_out(joined: Any) -> Any:
    """Return a joint in full: a pair of names alone bears any load."""
    own = with_tuples(joined)
    return {"parts": own} if isinstance(own, tuple) else own


JoinedParts = Annotated[
    JoinedSection,
    BeforeValidator(
        _joint_spelt_out, json_schema_input_type=JoinedSection | PairOf[Name]
    ),
]
"""Two names, or a section in full."""


def check_distinct_ends(
    at: KeyPath,
    ends: tuple[str, str],
    placed: Iterable[str],
    done: str,
    by: str = "",
) -> Problems:
    """Yield problems of a pair of equal names, or without a placed part."""
    first, second = ends
    if first == second:
        yield at, f"{first} cannot be {done} itself"
    elif {first, second}.isdisjoint(placed):
        yield at, f"neither {first} nor {second} is placed{by}"
