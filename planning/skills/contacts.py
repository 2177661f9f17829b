"""Allowed contacts before, during and after a skill."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from planning.geometry.robot_bodies import entity

Pairs = frozenset[frozenset[str]]
"""Unordered pairs of entities that may touch."""

NOTHING: Pairs = frozenset()


class Phase(Enum):
    """A part of a skill with the same allowed contacts and the same places of all things."""

    BEFORE = "before"
    UNTIL_CHANGE = "until the object changes hands"
    SINCE_CHANGE = "since the object changed hands"
    AFTER = "after"


@dataclass(frozen=True)
class SkillContacts:
    """Allowed contacts before, during and after a skill.

    Attributes:
        before: in the transits before it.
        during: in the skill.
        after: in the transit after it.
    """

    before: Pairs
    during: Pairs
    after: Pairs

    def in_phase(self, phase: Phase) -> Pairs:
        """Return the allowed contacts of a phase."""
        if phase is Phase.BEFORE:
            return self.before
        return self.after if phase is Phase.AFTER else self.during


@dataclass(frozen=True)
class ToolContact:
    """Depths by which a tool may overlap objects at rest in a skill, besides what it handles.

    Attributes:
        grazing: any object [m].
        pressing: objects that the skill is allowed to touch, and those to lean on [m].
        leaning: names of objects that it may lean on, as deep as on those it may touch.
    """

    grazing: float
    pressing: float
    leaning: frozenset[str] = frozenset()


def gripped(robot: str, item: str) -> Pairs:
    """Return the contact of a robot's tool with the object that it handles."""
    return touching(entity(robot, "tool"), [item])


def touching(one: str, others: Iterable[str]) -> Pairs:
    """Return the contacts of one thing with others."""
    return frozenset(frozenset((one, other)) for other in others)
