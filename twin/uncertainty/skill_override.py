"""Exceptions from the durations of skills, as sections of a scenario file."""

from __future__ import annotations

from pydantic import model_validator

from twin.durations import AnyDuration, Skill
from twin.scenario.document.section import Name, Section


class SkillOverride(Section):
    """An exception: a skill done by one robot, to one type of object, or both.

    The exception that names robot and object is the strongest, then the one that names the
    robot, then the one that names the object.

    Attributes:
        skill: which skill.
        robot: who does it; everyone when not given.
        object: type of what it is done to, such as ``2x4``; anything when not given.
        duration: how long it then takes.
    """

    skill: Skill
    robot: Name | None = None
    object: str | None = None
    duration: AnyDuration

    @model_validator(mode="after")
    def _names_something(self) -> SkillOverride:
        if self.robot is None and self.object is None:
            raise ValueError("name a robot, an object or both; else use 'skills'")
        return self
