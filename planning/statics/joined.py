"""What of an assembly is joined, when, and the friction under which it must stand, as data."""

from __future__ import annotations

from dataclasses import dataclass

from planning.statics.standing import Joint, StandingRules


@dataclass(frozen=True)
class Joined:
    """Two parts, or a part and a fixture, that are joined.

    Attributes:
        joint: whom, and what the joint bears.
        by: name of the step that joins them; None for the step that places the later of them.
    """

    joint: Joint
    by: str | None = None


@dataclass(frozen=True)
class BalanceRules:
    """Rules for the balance of what is built.

    Attributes:
        standing: friction, tilt, and what touches.
        joined: what is joined, and when.
    """

    standing: StandingRules
    joined: tuple[Joined, ...] = ()
