"""Causes of the end of an execution before its plan is complete."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

EndingCode = Literal["driver-lost", "off-path", "nothing-to-come", "no-progress"]
"""Causes: connection to the driver lost during a node; robot off its path; no further event; no progress for long."""


@dataclass(frozen=True)
class PendingNode:
    """The next node of a robot when an execution ends.

    Attributes:
        robot, node, task: the robot, the index of its node, and the index of the task of that.
        released: whether the robot was cleared for it, so that its driver's report is missing.
        waits_for: incomplete nodes that precede it by an edge: robots, and indices of their nodes.
        mode: of the robot, as its driver reported last; None before any report.
        held: whether the robot was ordered to stop.
    """

    robot: str
    node: int
    task: int
    released: bool
    waits_for: tuple[tuple[str, int], ...] = ()
    mode: str | None = None
    held: bool = False

    def words(self) -> str:
        """Return the sentence for people."""
        nodes = [f"node {node} of {robot}" for robot, node in self.waits_for]
        why = f"waits for {' and '.join(nodes) or 'its release'}"
        if self.released:
            why = f"is cleared for it and {'held' if self.held else self.mode or 'silent'}"
        return f"{self.robot} at node {self.node} {why}"


@dataclass(frozen=True)
class Ending:
    """Why a session ended before its plan was complete.

    Attributes:
        code: the kind of cause.
        robot: that caused it, empty for the whole cell.
        words: the same for people.
        pending: the next node of every robot that has any left, in the order of the chains.
    """

    code: EndingCode
    robot: str
    words: str
    pending: tuple[PendingNode, ...] = ()
