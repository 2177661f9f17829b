"""Gathers the candidates of the integer program, whatever is built, and why others are none (APEX-MR App. B)."""

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
        incompatible: pairs of their numbers that cannot go together.
        rejections: what is not a candidate, and why.
        blockers: by step, how often things were in the way.
    """

    def __init__(self, robots: Iterable[PlacedRobot]) -> None:
        self.home = {robot.name: robot.home for robot in robots}
        self.primaries: list[PrimaryCandidate] = []
        self.supports: list[SupportCandidate] = []
        self.incompatible: set[tuple[int, int]] = set()
        self.rejections: list[Rejection] = []
        self.blockers: dict[int, Counter[str]] = defaultdict(Counter)

    def cost(self, *paths: SkillPath) -> float:
        """Return the joint distance from HOME to where each of some skills touches what it is for."""
        return sum(joint_distance(self.home[p.robot], p.contact) for p in paths)

    def accept(self, step: int, what: str, found: Found | Obstruction) -> Found | None:
        """Return what was found, None for what is in the way, which is noted as a reason.

        Args:
            step: counted from 1.
            what: was tried, for people.
            found: for it.
        """
        if not isinstance(found, Obstruction):
            return found
        self.reject(step, what, found)
        return None

    def reject(self, step: int, what: str, reason: Obstruction | str) -> None:
        """Note why something is no candidate, and count what was in the way."""
        if isinstance(reason, str):
            reason = Obstruction(reason)
        self.rejections.append(Rejection(step, what, reason.words))
        if reason.by is not None:
            self.blockers[step][reason.by] += 1

    def problem(
        self, steps: Sequence[str], needs_support: Sequence[bool], **more: Any
    ) -> AssignmentProblem:
        """Return the problem of what was gathered.

        Args:
            steps: what they are, in words.
            needs_support: whether each is done by two robots.
            more: further attributes of ``AssignmentProblem``, and those that are others by now.
        """
        gathered = {
            "primaries": tuple(self.primaries),
            "supports": tuple(self.supports),
            "incompatible": frozenset(self.incompatible),
            "rejections": tuple(self.rejections),
        }
        return AssignmentProblem(
            robots=tuple(self.home),
            steps=tuple(steps),
            needs_support=tuple(needs_support),
            **{**gathered, **more},
        )
