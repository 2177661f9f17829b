"""Refill of a source of parts by machines."""

from __future__ import annotations

from dataclasses import dataclass

from planning.transforms import Transform

PlacedPart = tuple[str, Transform]
"""Name of a part, and the pose of its centre in the world."""


@dataclass(frozen=True)
class Refill:
    """Parts that arrive at a source once it is empty.

    Attributes:
        machine: name of the machine; its task ends when the parts have arrived.
        parts: names and poses of the parts that arrive.
        arrivals: name of the conveyor that transports the parts, None for other sources.
        buffer: parts that may wait on the conveyor, None for any number.
    """

    machine: str
    parts: tuple[PlacedPart, ...]
    arrivals: str | None = None
    buffer: int | None = None
