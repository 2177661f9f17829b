"""How hard the search over parts and robots tries."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SearchSettings:
    """How hard the search tries.

    Attributes:
        attempts: of each sequence of actions, before the next robots are tried.
        asked: robots that may plan a part before anything is tried hard, one after another, as
            long as each is late; where there are no more parts to place than for half of them.
        parts: that the first robot may plan before anything is tried hard, one after another,
            as long as it loses time with each; where there are more.
        late: a part that comes no later than this after speeds and the world at its place allow
            is not late, and so much is no loss [s].
        round: parts that are planned before it is looked at how much time was lost with them;
            no more than there are robots.
        tries: how often they are planned, at most.
        bearable: so much lost time for each of them is no reason to plan them again [s].
        again: attempts that may go into planning again, in all: for each part of the
            construction, over the number of robots, since among many each takes longer.
        efforts: how often failures are gone through again when nothing else is left, each
            time trying harder.
        returns: how often placements are taken back for one part, at most. Parts that keep each
            other from their places would take turns for ever.
    """

    attempts: int = 2
    asked: int = 3
    parts: int = 3
    late: float = 2.0
    round: int = 5
    tries: int = 3
    bearable: float = 3.0
    again: float = 6.0
    efforts: int = 3
    returns: int = 8
