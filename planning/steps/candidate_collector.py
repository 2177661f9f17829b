"""Collector of the candidates of the integer program, with reasons for rejections (APEX-MR App. B)."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from typing import Any, TypeVar

from planning.cell.workcell import PlacedRobot
from planning.steps.skill import Obstruction, SkillPath, joint_distance
from planning.tasks.assignment import (
    AssignmentProblem,
    PrimaryCandidate,
    Rejection,
    SupportCandidate,
)

Found = TypeVar("Found")


class CandidateCollector:
    """Gathers the candidates of an assembly step by step.

    Attributes:
        home: HOME of each robot, shape (n,).
        primaries, supports: the candidates, in the order in which they were found.
        incompatible: pairs (primary, support), by number, that cannot be combined.
        clashing: pairs of primaries of different steps, by number, that cannot be combined.
        dropped: numbers of primaries that are excluded afterwards.
        rejections: rejected candidates, with reasons.
        blockers: number of rejections by each obstacle, for each step.
    """

    def __init__(self, robots: Iterable[PlacedRobot]) -> None:
        self.home = {robot.name: robot.home for robot in robots}
        self.primaries: list[PrimaryCandidate] = []
        self.supports: list[SupportCandidate] = []
        self.incompatible: set[tuple[int, int]] = set()
        self.clashing: set[tuple[int, int]] = set()
        self.dropped: set[int] = set()
        self.rejections: list[Rejection] = []
        self.blockers: dict[int, Counter[str]] = defaultdict(Counter)

    def cost(self, *paths: SkillPath) -> float:
        """Return the joint distance from HOME to the contact configurations of some skills."""
        return sum(joint_distance(self.home[p.robot], p.contact) for p in paths)

    def accept(
        self, step: int, what: str, found: Found | Obstruction, robot: str | None = None
    ) -> Found | None:
        """Return a found path, or None for an obstruction, which is recorded as a rejection.

        Args:
            step: number of the step, from 1.
            what: description of what was tried, for messages.
            found: result of the attempt.
            robot: the robot; None for no particular one.
        """
        if not isinstance(found, Obstruction):
            return found
        self.reject(step, what, found, robot)
        return None

    def reject(
        self,
        step: int,
        what: str,
        reason: Obstruction | str,
        robot: str | None = None,
    ) -> None:
        """Record a rejection with its reason, and count its obstacle."""
        if isinstance(reason, str):
            reason = Obstruction(reason)
        self.rejections.append(Rejection(step, what, reason.words, robot, reason.by))
        if reason.by is not None:
            self.blockers[step][reason.by] += 1

    def problem(
        self, steps: Sequence[str], needs_support: Sequence[bool], **more: Any
    ) -> AssignmentProblem:
        """Return the assignment problem of the gathered candidates.

        Args:
            steps: their descriptions.
            needs_support: whether each is done by two robots.
            more: further attributes of ``AssignmentProblem``.
        """
        left = [p for p in range(len(self.primaries)) if p not in self.dropped]
        number = {p: k for k, p in enumerate(left)}
        return AssignmentProblem(
            robots=tuple(self.home),
            steps=tuple(steps),
            needs_support=tuple(needs_support),
            primaries=tuple(self.primaries[p] for p in left),
            supports=tuple(self.supports),
            incompatible=frozenset(
                (number[p], s) for p, s in self.incompatible if p in number
            ),
            rejections=tuple(self.rejections),
            clashing=frozenset(
                (number[p], number[q])
                for p, q in self.clashing
                if {p, q} <= number.keys()
            ),
            **more,
        )
