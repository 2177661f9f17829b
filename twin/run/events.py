"""Events of a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

EventKind = Literal[
    "released",
    "started",
    "completed",
    "waiting",
    "attached",
    "detached",
    "stalled",
    "resumed",
    "stopped",
    "failed",
    "retried",
    "finished",
]


@dataclass(frozen=True, slots=True)
class Event:
    """One thing that happened.

    Attributes:
        t_ns: time since the start of the run [ns].
        robot: who it happened to, empty for the whole cell.
        kind: what happened.
        task: index of the task, -1 where there is none.
        node: index of the robot's TPG node, -1 where there is none.
        object: name of the object, empty where there is none.
        detail: more, for people and for causes, such as the edge waited for.
    """

    t_ns: int
    robot: str
    kind: EventKind
    task: int = -1
    node: int = -1
    object: str = ""
    detail: str = ""
