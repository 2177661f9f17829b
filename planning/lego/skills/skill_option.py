"""A way for a robot to do a skill of a LEGO assembly, or why there is none."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from planning.skills.joint_paths import Obstruction, SkillPath


@dataclass(frozen=True)
class SkillOption:
    """A collision-free execution of a skill by one robot.

    Attributes:
        path: in joint space.
        after: stock bricks that stand in the way until they have been used.
        latest: last step at which it is possible, because a later brick is in the way; None
            when none is.
        touched: bricks that the tool grazes, False, or leans on, True.
    """

    path: SkillPath
    after: frozenset[str] = frozenset()
    latest: int | None = None
    touched: Mapping[str, bool] = field(default_factory=dict)


Found = SkillOption | Obstruction
"""A free execution of a skill, or why there is none."""


def is_blocked(found: Found) -> bool:
    """Tell whether things are in the way of a skill, for good or until they are gone."""
    if isinstance(found, Obstruction):
        return found.by is not None
    return bool(found.after)


def first_option(tried: Iterable[Found]) -> Found:
    """Return the first way that is free, or else why the first one is not."""
    reason: Obstruction | None = None
    for option in tried:
        if isinstance(option, SkillOption):
            return option
        reason = reason or option
    assert reason is not None
    return reason
