"""Sequences of actions that bring a part to its place (Hartmann et al. IV-D3, V-A3)."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

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

    def __str__(self) -> str:
        """Return it in words."""
        return f"{self.robot} {self.kind}" + (f" to {self.to}" if self.to else "")


Skeleton = tuple[Action, ...]


def skeletons(robots: Sequence[str], most: int = 8) -> Iterator[Skeleton]:
    """Yield the sequences in which every robot of a group has a part in hand once.

    Breadth first, so the shortest come first; a part is picked and placed once (monotone).

    Args:
        robots: the group.
        most: longest sequence.
    """
    front: deque[tuple[Skeleton, tuple[str, ...], str]] = deque([((), (), "supply")])
    while front:
        done, had, where = front.popleft()
        if where == "in place":
            yield done
            continue
        if len(done) >= most:
            continue
        for action, robot, then in _possible(robots, had, where):
            front.append(((*done, action), (*had, *robot), then))


def _possible(
    robots: Sequence[str], had: tuple[str, ...], where: str
) -> Iterator[tuple[Action, tuple[str, ...], str]]:
    """Yield what may come next: an action, who has the part then for the first time, where it is."""
    if where == "supply":
        for robot in robots:
            yield Action(PICK, robot), (robot,), "held"
    elif where == "held":
        if len(had) == len(robots):
            yield Action(PLACE, had[-1]), (), "placed"
        for taker in robots:
            if taker not in had:
                yield Action(HANDOVER, had[-1], taker), (taker,), "held"
    elif where == "placed":
        yield Action(RETRACT, had[-1]), (), "in place"


def in_words(skeleton: Skeleton) -> str:
    """Return a sequence in words."""
    return ", ".join(map(str, skeleton))


def robots_of(skeleton: Skeleton) -> tuple[str, ...]:
    """Return who acts in a sequence, in order of first appearance."""
    return tuple(dict.fromkeys(action.robot for action in skeleton))
