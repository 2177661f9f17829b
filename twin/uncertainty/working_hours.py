"""Planned stops and weekly shifts of robots and machines, as sections of a scenario file."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from planning.bounds import LONGEST_S
from twin.document.section import Name, Section, Several

Day = Literal["Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun"]
"""Day of the week."""

DAYS: tuple[Day, ...] = ("Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun")

DAY_S, WEEK_S = 86_400.0, 604_800.0
"""Lengths of a day and of a week [s]."""

_TIME = re.compile(r"([01]?\d|2[0-4]):([0-5]\d)")


class PlannedStop(Section):
    """A stop that is known beforehand, such as a break or maintenance; afterwards, work is resumed where it stopped.

    Attributes:
        at_s: when [s].
        duration_s: for how long [s].
        every_s: period, if it is repeated [s].
        who: robots and machines that stop; all of them when not given.
    """

    at_s: Annotated[float, Field(ge=0, le=LONGEST_S)]
    duration_s: Annotated[float, Field(gt=0, le=LONGEST_S)]
    every_s: Annotated[float, Field(gt=0, le=LONGEST_S)] | None = None
    who: Several[Name] | None = None

    @model_validator(mode="after")
    def _shorter_than_its_period(self) -> PlannedStop:
        if self.every_s is not None and self.duration_s >= self.every_s:
            raise ValueError("duration_s must be shorter than every_s")
        return self

    def affects(self, name: str) -> bool:
        """Return whether a robot or machine of a name stops."""
        return self.who is None or name in self.who


class Shift(Section):
    """Hours of work on some days of the week.

    Attributes:
        days: on which it begins.
        start, end: times of the day, such as ``06:00``; a shift that ends earlier than it starts ends on the next day.
        who: robots and machines that work then; all of them when not given.
    """

    days: Several[Day]
    start: str
    end: str
    who: Several[Name] | None = None

    @field_validator("start", "end")
    @classmethod
    def _time_of_day(cls, text: str) -> str:
        _seconds(text)
        return text

    @model_validator(mode="after")
    def _lasts(self) -> Shift:
        if _seconds(self.start) == _seconds(self.end):
            raise ValueError("start and end are the same; all day is 00:00 to 24:00")
        return self

    def intervals(self) -> Iterator[tuple[float, float]]:
        """Yield start and end on each of its days, from Monday 00:00 on [s]."""
        start, end = _seconds(self.start), _seconds(self.end)
        length = end - start if end > start else end - start + DAY_S
        for day in self.days:
            begin = DAYS.index(day) * DAY_S + start
            yield begin, begin + length


class Calendar(Section):
    """Weekly calendar of shifts.

    Attributes:
        begins: day and time at which the run begins, such as ``Mon 06:00``.
        shifts: hours of work. Robots and machines that none of them names, and for which none is without names,
            work all the time.
    """

    begins: str = "Mon 00:00"
    shifts: Several[Shift]

    @field_validator("begins")
    @classmethod
    def _day_and_time(cls, text: str) -> str:
        _week_seconds(text)
        return text

    def off_shift(self, name: str) -> list[tuple[float, float]]:
        """Return when a robot or machine goes off shift in a week of the run, and when it returns [s].

        Empty if it always works.
        """
        shifts = [own for own in self.shifts if own.who is None or name in own.who]
        if not shifts:
            return []
        begins = _week_seconds(self.begins)
        works = sorted(
            (start - begins + week * WEEK_S, end - begins + week * WEEK_S)
            for own in shifts
            for start, end in own.intervals()
            for week in range(-2, 3)
        )
        found, until = list[tuple[float, float]](), works[0][1]
        for start, end in works:
            if start > until and 0.0 <= until < WEEK_S:
                found.append((until, start))
            until = max(until, end)
        return found


def _seconds(text: str) -> float:
    match = _TIME.fullmatch(text.strip())
    if match is None or (int(match[1]) == 24 and int(match[2]) > 0):
        raise ValueError(f"{text!r} is no time of day, such as 06:00")
    return int(match[1]) * 3600.0 + int(match[2]) * 60.0


def _week_seconds(text: str) -> float:
    day, _, time = text.strip().partition(" ")
    if day not in DAYS:
        raise ValueError(f"begin with one of {', '.join(DAYS)}, such as Mon 06:00")
    return DAYS.index(day) * DAY_S + _seconds(time)
