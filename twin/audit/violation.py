"""A violation that the audit found, and the kinds there are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

ViolationKind = Literal[
    "contact",
    "jump",
    "joint-limit",
    "joint-speed",
    "joint-acceleration",
    "joint-jerk",
    "joint-effort",
    "joint-motion",
    "tool-speed",
    "edge-order",
    "hanging",
    "balance",
    "grip",
    "place",
    "support",
    "process",
    "tool",
    "hand",
    "duration",
]


@dataclass(frozen=True)
class Violation:
    """An event of a run that nothing allows.

    Attributes:
        t_start, t_end: first and last moment at which it was seen [s].
        first, second: who and what. Of a ``contact`` two entities, such as ``"left/arm"``,
            ``"right/tool"``, ``"b3"``, ``"plate"``; of a ``jump`` the object and
            ``"jump"``; of the kinds of joints the robot and
            its joint, or ``"all joints"``; of a ``tool-speed`` the robot and ``"tool"``; of an ``edge-order`` the robots, the one that must be complete first; of
            ``hanging`` the object and the nearest thing that stands; of ``balance`` what falls and
            ``"gravity"``; of a ``grip`` the object and its holder; of a ``place`` the object and its place; of a ``support`` the object
            and who is nearest to being its support, or the two robots of a handover; of a ``process`` what was to be done and the thing at
            which, or two steps of which the first began too early; of a ``tool`` the tool and the
            robot that has it on it, or ``"rack"``. Of plans of others also of a ``hand`` the robot and the object that it
            cannot take or give; of a ``duration`` the robot and its work; of a ``jump`` the robot and its joint.
        depth_m: greatest overlap, 0 for robots that just touch; of a jump its length; of what
            hangs, a grip or a support the distance; of a place or a tool how far off; 0 for kinds that are
            no lengths [m].
        detail: the links that overlapped most, or what is wrong, and how much.
        kind: what is not allowed.
    """

    t_start: float
    t_end: float
    first: str
    second: str
    depth_m: float
    detail: str = ""
    kind: ViolationKind = "contact"
