"""Rules for the static stability of bodies at rest: friction, tilt, and joints between them."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Joint:
    """Two bodies joined at their contact, such as by a weld or a screw, or across a gap.

    Attributes:
        first, second: names of the bodies; either may belong to the ground.
        force: largest force that the joint bears along each axis [N].
        torque: largest torque that the joint bears about each axis [N m].
        gap: distance between them, bridged by a connector that is not a part of the assembly [m].
        by: name of the step that joins them; None for the one that places the later of them.
    """

    first: str
    second: str
    force: float = math.inf
    torque: float = math.inf
    gap: float = 0.0
    by: str | None = None

    @property
    def ends(self) -> tuple[str, str]:
        """Names of both bodies."""
        return self.first, self.second

    @property
    def is_unlimited(self) -> bool:
        """True if force and torque have no limit."""
        return math.isinf(self.force) and math.isinf(self.torque)


@dataclass(frozen=True)
class StandingRules:
    """Assumptions about bodies at rest.

    Attributes:
        friction: least coefficient of friction of all contacts.
        tilt: greatest angle by which gravity may be tilted [rad].
        touch: distance below which two bodies count as touching [m].
        joints: joints between named bodies.
        joined_within: distance below which two bodies count as joined without limits of force and torque, besides
            ``joints``; 0 for none [m].
    """

    friction: float = 0.4
    tilt: float = math.radians(1.0)
    touch: float = 0.002
    joints: tuple[Joint, ...] = ()
    joined_within: float = 0.0
