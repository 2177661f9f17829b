"""Skeletons: sequences of actions that bring a part to its place (Hartmann et al. IV-D3, V-A3)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, permutations

PICK, HANDOVER, PLACE, RETRACT = "pick", "handover", "place", "retract"
"""The actions: place is always followed by retract."""


@dataclass(frozen=True)
class Action:
    """A mode switch.

    Attributes:
        kind: PICK, HANDOVER, PLACE or RETRACT.
        robot: who does it.
        to: who takes the part over in a handover.
    """

    kind: str
    robot: str
    to: str | None = None


Skeleton = tuple[Action, ...]


def skeletons(robots: Sequence[str]) -> Iterator[Skeleton]:
    """Yield the sequences in which every robot of a group has a part in hand once.

    A part is picked and placed once (monotone).
    """
    for order in permutations(robots):
        yield (
            Action(PICK, order[0]),
            *(Action(HANDOVER, giver, taker) for giver, taker in pairwise(order)),
            Action(PLACE, order[-1]),
            Action(RETRACT, order[-1]),
        )


def robots_of(skeleton: Skeleton) -> tuple[str, ...]:
    """Return the robots that act in a sequence, in order of first appearance."""
    return tuple(dict.fromkeys(action.robot for action in skeleton))
