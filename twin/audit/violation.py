"""A violation that the audit found, and the kinds there are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

ViolationKind = Literal["contact", "jump", "joint-limit", "joint-speed", "edge-order"]


@dataclass(frozen=True)
class Violation:
    """What was executed though nothing allows it.

    Attributes:
        t_start, t_end: first and last moment at which it was seen [s].
        first, second: who and what. Of a ``contact`` two entities, such as ``"left/arm"``,
            ``"right/tool"``, ``"b3"``, ``"plate"``; of a ``jump`` the object and
            ``"jump"``; of a ``joint-limit`` or ``joint-speed`` the robot and
            its joint; of an ``edge-order`` the robots, the one that must be complete first.
        depth_m: greatest overlap, 0 for robots that just touch; of a jump its length; 0 for kinds that are no lengths [m].
        detail: the links that overlapped most, or how far beyond what is allowed.
        kind: what is not allowed.
    """

    t_start: float
    t_end: float
    first: str
    second: str
    depth_m: float
    detail: str = ""
    kind: ViolationKind = "contact"
