"""Refill of a source of parts by machines."""

from __future__ import annotations

from dataclasses import dataclass

from planning.transforms import Transform

PlacedPart = tuple[str, Transform]
"""Name of a part and where its centre lies in the world."""


@dataclass(frozen=True)
class Refill:
    """Parts that arrive at a source once it is empty.

    Attributes:
        machine: its chain, whose task is over when they are there.
        parts: what comes up, where.
        arrivals: chain of the conveyor along which they come, None for other sources.
        buffer: parts that may wait on the conveyor, None for any number.
    """

    machine: str
    parts: tuple[PlacedPart, ...]
    arrivals: str | None = None
    buffer: int | None = None
