"""How hard the search over parts and robots tries."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SearchSettings:
    """How hard the search tries.

    Attributes:
        attempts: of each sequence of actions, before the next robots are tried.
        group: most robots that work on one part together.
        asked: robots that may plan a part before anything is tried hard, one after another, as
            long as each is late; where there are no more parts to place than for half of them.
        parts: that the first robot may plan before anything is tried hard, one after another,
            as long as it loses time with each; where there are more.
        late: a part that comes no later than this after speeds and the world at its place allow
            is not late, and so much is no loss [s].
        efforts: how often failures are gone through again when nothing else is left, each
            time trying harder.
    """

    attempts: int = 2
    group: int = 2
    asked: int = 3
    parts: int = 3
    late: float = 2.0
    efforts: int = 3
