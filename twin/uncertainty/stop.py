"""A stop of a robot or machine, whatever its task."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

StopCode = Literal["off-shift", "planned", "breakdown", "emergency"]
"""Why something stops by the clock of the run."""

STOP_CODES: tuple[StopCode, ...] = get_args(StopCode)
"""All codes; of stops that overlap, the first one counts."""


@dataclass(frozen=True)
class Stop:
    """An interval in which a robot stands, whatever its task.

    Attributes:
        start_ns, end_ns: interval [ns]; at its end the robot continues.
        code: why, for programs.
        reason: why, for people.
    """

    start_ns: int
    end_ns: int
    code: StopCode
    reason: str
