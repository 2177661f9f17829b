"""Supply of an assembly: arrivals of parts and departures of products between its steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from planning.tasks.refill import PlacedPart, Refill


@dataclass(frozen=True)
class Leaving:
    """Parts of finished products that leave the cell together.

    Attributes:
        machine: name of the machine; its task ends when the parts have left.
        parts: names and poses of the parts that leave.
    """

    machine: str
    parts: tuple[PlacedPart, ...]


@dataclass(frozen=True)
class Changeover:
    """Work without a robot between two products of different variants.

    Attributes:
        machine: name of the machine or the person that does it.
        part: first part of the product for which it is done.
        words: description for people.
        after: numbers of the steps, from 1, that are complete before it begins.
        before: numbers of the steps that begin after it.
        left: whether it also begins after the product before it has left.
    """

    machine: str
    part: str
    words: str
    after: frozenset[int]
    before: frozenset[int]
    left: bool


@dataclass(frozen=True)
class Supply:
    """Arrivals and departures of parts while the steps of an assembly are done, in order.

    Attributes:
        refills: by number of the step, from 1, whose pick empties the source.
        leaves: by number of the step after which they do, from 1.
        elsewhere: numbers of the steps that are not done at the place of a product: a part is put
            down on its way, or worked at there.
        sourced: names of the parts that come from sources.
        in_progress: greatest number of products that are begun and not complete, None for any.
        products: product of each step, from 1; empty where ``in_progress`` is None.
        changeovers: between products, in their order.
    """

    refills: Mapping[int, Refill] = field(default_factory=dict)
    leaves: Mapping[int, Leaving] = field(default_factory=dict)
    elsewhere: frozenset[int] = frozenset()
    sourced: frozenset[str] = frozenset()
    in_progress: int | None = None
    products: tuple[int, ...] = ()
    changeovers: tuple[Changeover, ...] = ()

    @cached_property
    def changeovers_after(self) -> dict[int, list[Changeover]]:
        """Changeovers by the last of the steps after which they begin."""
        found: dict[int, list[Changeover]] = {}
        for own in self.changeovers:
            found.setdefault(max(own.after), []).append(own)
        return found

    @cached_property
    def buffers(self) -> dict[str, tuple[str, int]]:
        """By accumulating conveyor: the machine that presents its parts, and its capacity."""
        return {
            refill.arrivals: (refill.machine, refill.buffer)
            for refill in self.refills.values()
            if refill.arrivals is not None and refill.buffer is not None
        }
