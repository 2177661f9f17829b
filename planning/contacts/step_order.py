"""What comes before what among steps, and the order nearest to their list that keeps it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise


@dataclass(frozen=True)
class StepPrecedence:
    """What comes before what among steps.

    Attributes:
        words: what the steps are, for people.
        before: for each step, the steps that come before it, and why; numbers are places in the
            list.
        any_of: for each step, steps of which one at least comes before it; none where it needs
            none.
        closing: by step whose part is kept hold of, the steps one of which lets go of it: it
            comes as soon as it can.
    """

    words: tuple[str, ...]
    before: tuple[dict[int, str], ...]
    any_of: tuple[frozenset[int], ...]
    closing: Mapping[int, frozenset[int]] = field(default_factory=dict)

    def require(self, first: int, then: int, why: str) -> None:
        """Let one step come before another."""
        if first != then:
            self.before[then].setdefault(first, why)

    def with_required(self, first: int, then: int, why: str) -> StepPrecedence:
        """Return the same and that one step comes before another."""
        out = replace(self, before=tuple(dict(own) for own in self.before))
        out.require(first, then, why)
        return out

    def order(self) -> tuple[int, ...] | None:
        """Return the order nearest to the list, None where steps wait for each other.

        The first step that can be done is done first, so no other order that keeps everything
        comes before it in the order of numbers; but while a part is kept hold of, what leads to
        letting go of it.
        """
        done = self._doable()
        return done if len(done) == len(self.before) else None

    def explained(self) -> str:
        """Return in words why there is no order."""
        done = set(self._doable())
        stuck = [k for k in range(len(self.before)) if k not in done]
        way = [stuck[0]]
        while way[-1] not in way[:-1]:
            waits = [k for k in self.before[way[-1]] if k not in done]
            if not waits:
                others = ", ".join(self.words[k] for k in sorted(self.any_of[way[-1]]))
                return f"  {self.words[way[-1]]} needs one of these before it: {others}"
            way.append(min(waits))
        circle = way[way.index(way[-1]) :]
        return "\n".join(
            f"  {self.words[then]} comes after {self.words[first]}: {self.before[then][first]}"
            for then, first in pairwise(circle)
        )

    def _doable(self) -> tuple[int, ...]:
        """Return the steps that can be done one after another, as far as that goes."""
        out: list[int] = []
        done: set[int] = set()
        while True:
            ready = [
                k
                for k, own in enumerate(self.before)
                if k not in done
                and own.keys() <= done
                and (not self.any_of[k] or self.any_of[k] & done)
            ]
            if not ready:
                return tuple(out)
            urgent = (k for way in self._to_let_go(done) for k in ready if k in way)
            step = next(urgent, ready[0])
            out.append(step)
            done.add(step)

    def _to_let_go(self, done: set[int]) -> list[set[int]]:
        """Return what leads to letting go of each part that is kept hold of, the least first."""
        ways = []
        for placed, ends in self.closing.items():
            if placed not in done or not ends.isdisjoint(done):
                continue
            for end in ends:
                way, front = {end}, [end]
                while front:
                    new = self.before[front.pop()].keys() - way - done
                    way |= new
                    front += new
                ways.append(way)
        return sorted(ways, key=lambda way: (len(way), min(way)))
