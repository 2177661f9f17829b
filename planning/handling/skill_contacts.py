"""Contacts that are allowed before, in and after a skill."""

from __future__ import annotations

from dataclasses import dataclass

from planning.geometry.robot_bodies import entity_name
from planning.steps.skill import Pairs, contacts_with

NOTHING: Pairs = frozenset()


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


@dataclass(frozen=True)
class ToolContact:
    """Depths by which a tool may overlap resting objects in a skill, besides the handled one.

    Attributes:
        grazing: any object [m].
        pressing: objects that the skill is allowed to touch, and those to lean on [m].
        leaning: names of objects that it may lean on, as deep as on those it may touch.
    """

    grazing: float
    pressing: float
    leaning: frozenset[str] = frozenset()


def grip_contact(robot: str, item: str) -> Pairs:
    """Return the contact of a robot's tool with the object that it handles."""
    return contacts_with(entity_name(robot, "tool"), [item])
