"""A stop of a robot or machine, whatever its task."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Stop:
    """An interval in which a robot stands, whatever its task.

    Attributes:
        start_ns, end_ns: interval [ns]; at its end the robot continues.
        reason: reason, for people.
    """

    start_ns: int
    end_ns: int
    reason: str
