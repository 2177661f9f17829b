"""Exceptions from what holds for a skill: for a robot, for a type of objects, or for both."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

T = TypeVar("T")

ExceptionKey = tuple[str, str | None, str | None]
"""Skill, robot and type of object of an exception; None stands for any."""


def strongest_exception(
    exceptions: Mapping[ExceptionKey, T], skill: str, robot: str, kind: str | None
) -> T | None:
    """Return what holds for a skill done by a robot to an object of a kind, None if nothing does.

    Robot and object beat the robot alone, which beats the object alone.
    """
    for key in ((skill, robot, kind), (skill, robot, None), (skill, None, kind)):
        found = exceptions.get(key)
        if found is not None:
            return found
    return None
