"""Usual ranges of quantities, to find values that are probably mistakes."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import get_args

from twin.durations.model import PackagedSkill


@dataclass(frozen=True)
class UsualRange:
    """Range of the values that a key has in practice.

    Attributes:
        low, high: least and greatest size; a value may be negative.
        unit: of both.
        why: reason for the range.
        zero: whether 0 is usual, too, such as for instantaneous work.
    """

    low: float
    high: float
    unit: str
    why: str
    zero: bool = True

    def words(self, value: float) -> str | None:
        """Return a message on an unusual value; None for a usual one."""
        size = abs(value)
        if self.low <= size <= self.high or (self.zero and size == 0.0):
            return None
        side, unit = "below" if size < self.low else "above", f" {self.unit}".rstrip()
        return (
            f"{value:g}{unit} is far {side} what is usual, {self.low:g} to {self.high:g}{unit}"
            f" ({self.why}): correct it, unless it is meant"
        )


_SKILL = UsualRange(0.05, 600, "s", "a robot grips and places within minutes")
_WORK = UsualRange(1e-3, 1e5, "s", "work in a cell takes up to a day")


def usual_duration(names: Collection[str]) -> UsualRange:
    """Return the usual durations of skills or processes, by the names of their tasks."""
    work = bool(names) and set(get_args(PackagedSkill)).isdisjoint(names)
    return _WORK if work else _SKILL
