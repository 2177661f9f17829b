"""A skill of a robot as a path in joint space, its contacts, and what obstructs it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from planning.cell.workcell import PlacedRobot
from planning.geometry.robot_bodies import entity_name
from planning.transforms import Array

Pairs = frozenset[frozenset[str]]
"""Unordered pairs of entities that may touch."""


class Phase(Enum):
    """A part of a skill with constant allowed contacts and object poses."""

    BEFORE = "before"
    UNTIL_CHANGE = "until the object changes hands"
    SINCE_CHANGE = "since the object changed hands"
    AFTER = "after"

    @property
    def in_skill(self) -> bool:
        """Whether it belongs to the skill itself, not to the transits around it."""
        return self in (Phase.UNTIL_CHANGE, Phase.SINCE_CHANGE)


def tool_entity(robot: PlacedRobot) -> str:
    """Return the entity name of a robot's mounted tool in allowed contacts."""
    return str(robot.tool) if robot.tools else entity_name(robot.name, "tool")


def handled_contact(robot: PlacedRobot, item: str) -> Pairs:
    """Return the contact of the mounted tool of a robot with the object that it handles."""
    return contacts_with(tool_entity(robot), [item])


def contacts_with(one: str, others: Iterable[str]) -> Pairs:
    """Return the contacts of one thing with others."""
    return frozenset(frozenset((one, other)) for other in others)


@dataclass(frozen=True)
class SkillPath:
    """A skill of one robot in joint space.

    Attributes:
        skill: its name.
        robot: the robot.
        lead: goals of the transits before it, shape (l, n); the skill starts from the last.
        path: its reference path after the start, shape (w, n).
        change_at: waypoint of ``[lead[-1], *path]`` at which an object changes hands, None if
            none does.
    """

    skill: str
    robot: str
    lead: Array
    path: Array
    change_at: int | None = None

    @property
    def waypoints(self) -> Array:
        """The configuration it starts from and its path, shape (w + 1, n)."""
        return np.vstack([self.lead[-1:], self.path])

    @property
    def contact(self) -> Array:
        """The configuration for costs: where the object changes hands."""
        at = len(self.path) if self.change_at is None else self.change_at
        return np.asarray(self.waypoints[at])


@dataclass(frozen=True)
class Obstruction:
    """The reason why a skill is not possible as planned.

    Attributes:
        words: the reason.
        by: name of the blocking object, fixture or robot part, None if that is not the cause.
        phase: where that is so before the skill begins or after it is over, else None.
        moving: entity of the robot, or object in its hand, that meets it; None if that is not the cause.
    """

    words: str
    by: str | None = None
    phase: Phase | None = None
    moving: str | None = None


def joint_distance(q_a: Array, q_b: Array) -> float:
    """Return the sum of absolute joint differences, the cost of Appendix B [rad]."""
    return float(np.abs(q_a - q_b).sum())
