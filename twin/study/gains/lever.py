"""Levers: things that take time in a plan, and could take less."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from planning.transforms import Indices
from twin.uncertainty.chain_draws import Cause

Kind = Literal["task", "skill", "robot", "wait", "stall", "message"]


def _none() -> Indices:
    return np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class Lever:
    """Something that takes time in a plan, and could take less or none.

    Attributes:
        kind: a task, all tasks of a kind, all work of a robot, waits of one task for another or all waits of a
            cause, standstills, or messages.
        name: in words.
        robot: whose it is, empty where it is nobody's own.
        task: index of the task, of a wait that of the task that waits; None where there is none.
        rows: nodes whose time it is a part of, numbered through chain by chain.
        causes: the standstills of these nodes that it is; none where it is their work.
        edges: what is waited for, as indices of edges.
        stops: the stops by the run's clock that it is, empty where it is none.
        messages: True where it is the messages between robots and dispatcher.
    """

    kind: Kind
    name: str
    robot: str = ""
    task: int | None = None
    rows: Indices = field(default_factory=_none)
    causes: tuple[Cause, ...] = ()
    edges: Indices = field(default_factory=_none)
    stops: Literal["", "breakdowns", "emergency stops"] = ""
    messages: bool = False

    @property
    def many(self) -> bool:
        """True where it is many things at once, and not one task, wait or robot's standstills."""
        if self.kind in ("task", "wait"):
            return self.task is None
        return self.kind != "stall" or not self.robot
