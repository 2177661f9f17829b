"""Precedence constraints between parts and between steps: contact graph, order of steps, and detection of cycles.

``PartGraph`` holds the contacts between the parts of the finished structure, and finds the parts that may be placed
next (Hartmann et al., Section V-A1, eq. 6). ``StepPrecedence`` collects constraints between steps with their reasons.
It reorders a list of steps as little as possible to satisfy them, or finds a cycle of steps that wait for each other.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from graphlib import TopologicalSorter
from itertools import pairwise
from typing import TypeVar

from planning.contacts.interference import Overlaps, sweeps_through
from planning.contacts.touching import (
    NEAR,
    TOUCH,
    PlacedObject,
    lowest_height,
    nearby_entities,
)
from planning.errors import ConstructionError
from planning.transforms import Array, translation

_SINK = 0.01
"""Distance by which a part is moved down virtually to find its supports [m]."""

_RESTS = 0.5
"""Least decrease of a gap, as a share of ``_SINK``, by which a part counts as resting on another one."""


Item = TypeVar("Item")


@dataclass(frozen=True)
class PartGraph:
    """Contacts of the finished structure.

    Attributes:
        neighbours: part to the parts that it touches.
        ground: part to the fixtures that it touches; parts that touch no fixture are left out.
        carriers: part to the neighbours that must be placed before it: those that it rests on, and those
            whose insertion path it would block.
        covers: part to the parts stacked on it in the supply, which must be picked first; parts without
            others on them may be left out.
    """

    neighbours: Mapping[str, frozenset[str]]
    ground: Mapping[str, frozenset[str]]
    carriers: Mapping[str, frozenset[str]]
    covers: Mapping[str, frozenset[str]] = field(default_factory=dict)

    def placeable(
        self, placed: Collection[str], *, carried: bool = True
    ) -> tuple[str, ...]:
        """Return the parts that may be placed next, in the order of the graph.

        Args:
            placed: the parts that are in place.
            carried: whether a part waits for everything that it rests on. If False, one placed
                neighbour is enough, as in the paper.
        """
        there = frozenset(placed)
        return tuple(
            part
            for part, near in self.neighbours.items()
            if part not in there
            and (part in self.ground or near & there)
            and (not carried or self.carriers[part] <= there)
            and self.covers.get(part, frozenset()) <= there
        )

    def placed_neighbours(self, part: str, placed: Collection[str]) -> int:
        """Return how many neighbours of a part are in place: the heuristic h of eq. 6."""
        return len(self.neighbours[part].intersection(placed))

    def floating(self) -> tuple[str, ...]:
        """Return the parts that no chain of contacts connects to the ground."""
        reached = _reached(self.ground, self.neighbours.__getitem__)
        return tuple(part for part in self.neighbours if part not in reached)

    def never_placeable(self, *, carried: bool = True) -> tuple[str, ...]:
        """Return the parts that can never be placed, since they wait for each other; see ``placeable``."""
        placed: set[str] = set()
        while new := self.placeable(placed, carried=carried):
            placed.update(new)
        return tuple(part for part in self.neighbours if part not in placed)

    @cached_property
    def piled_on(self) -> Mapping[str, int]:
        """Number of levels of parts stacked on each part."""
        out = dict.fromkeys(self.carriers, 0)
        for part in reversed(list(TopologicalSorter(self.carriers).static_order())):
            for below in self.carriers[part]:
                out[below] = max(out[below], out[part] + 1)
        return out


def build_part_graph(
    parts: Mapping[str, PlacedObject],
    fixtures: Sequence[PlacedObject],
    *,
    touch: float = TOUCH,
    covers: Mapping[str, frozenset[str]] | None = None,
    overlaps: Overlaps | None = None,
) -> PartGraph:
    """Find the contacts of parts when every part is in its place.

    A part rests on a neighbour if moving the part down reduces the gap between them by more than half that
    distance.

    Args:
        parts: every part in its place, by name.
        fixtures: all fixtures with their poses.
        touch: greatest gap between parts that count as touching [m].
        covers: see PartGraph and ``parts_stacked_on``.
        overlaps: allowed overlaps; by default only rounding errors.

    Raises:
        ConstructionError: two parts, or a part and a fixture, would overlap.
    """
    grounds = {item.name: (item, pose) for item, pose in fixtures}
    neighbours, ground, carriers = {}, {}, {}
    for name, (item, pose) in parts.items():
        others = {key: value for key, value in parts.items() if key != name}
        near = nearby_entities((item, pose), others | grounds, touch)
        known = overlaps or Overlaps()
        for other, deep in known.is_too_deep(
            name, (item, pose), others | grounds
        ).items():
            raise ConstructionError(
                f"{name} and {other} would overlap by {deep * 1e3:.3g} mm where they belong"
                + ("" if overlaps is None else overlaps.remedy(name, other, deep)),
                parts=[name],
            )
        neighbours[name] = frozenset(key for key in near if key in others)
        carriers[name] = _below((item, pose), others, near, touch)
        if fixed := frozenset(near) & frozenset(grounds):
            ground[name] = fixed
    return PartGraph(neighbours, ground, carriers, covers or {})


def with_insertions(
    graph: PartGraph,
    parts: Mapping[str, PlacedObject],
    insertions: Mapping[str, Array],
    approach: float,
) -> PartGraph:
    """Return the graph in which a part also waits for those whose insertion path it would block.

    Planning allows contact between parts that touch in place, so it would not notice an insertion path
    through a neighbour. Two parts that block each other wait for each other, which ``never_placeable``
    finds.

    Args:
        graph: the part graph.
        parts: every part in its place, by name.
        insertions: direction of the straight insertion path of each part, shape (3,).
        approach: length of that path [m].
    """
    carriers = dict(graph.carriers)
    for name, placed in parts.items():
        near = {k: parts[k] for k in sorted(graph.neighbours[name])}
        for other in nearby_entities(placed, near, NEAR):
            settled = other in graph.carriers[name] or name in graph.carriers[other]
            if not settled and sweeps_through(
                placed, near[other], insertions[name], approach
            ):
                carriers[other] |= {name}
    return replace(graph, carriers=carriers)


def parts_stacked_on(parts: Mapping[str, PlacedObject]) -> dict[str, frozenset[str]]:
    """Return the parts stacked on each part in the supply; parts without others on them are left out.

    Args:
        parts: every part in its start pose, by name.
    """
    bottom = {name: lowest_height(placed) for name, placed in parts.items()}
    floor = min(bottom.values(), default=0.0) + _SINK
    above: dict[str, set[str]] = {}
    for name, placed in parts.items():
        if bottom[name] > floor:
            others = {key: value for key, value in parts.items() if key != name}
            for below in _below(
                placed, others, nearby_entities(placed, others, _SINK), _SINK
            ):
                above.setdefault(below, set()).add(name)
    return {name: frozenset(found) for name, found in above.items()}


def _below(
    placed: PlacedObject,
    others: Mapping[str, PlacedObject],
    near: Mapping[str, float],
    touch: float,
) -> frozenset[str]:
    """Return the parts that a part rests on: those whose gap to it shrinks when it is moved down."""
    item, pose = placed
    sunk = (item, translation(0.0, 0.0, -_SINK) @ pose)
    close = {key: others[key] for key in near if key in others}
    gaps = nearby_entities(sunk, close, touch)
    return frozenset(k for k, gap in gaps.items() if near[k] - gap > _RESTS * _SINK)


@dataclass(frozen=True)
class StepPrecedence:
    """Precedence constraints between steps, which are numbered by their position in a list.

    Attributes:
        words: descriptions of the steps, for messages.
        before: for each step, the steps that must come before it, with the reasons.
        any_of: for each step, alternatives of which at least one must come before it; empty without such a
            constraint.
        closing: steps after which a robot keeps holding the part, with the steps that release it; one of
            these is done as early as possible.
    """

    words: tuple[str, ...]
    before: tuple[dict[int, str], ...]
    any_of: tuple[frozenset[int], ...]
    closing: Mapping[int, frozenset[int]] = field(default_factory=dict)

    def require(self, first: int, then: int, why: str) -> None:
        """Require one step before another."""
        if first != then:
            self.before[then].setdefault(first, why)

    def with_required(self, first: int, then: int, why: str) -> StepPrecedence:
        """Return the same constraints with one more pair of steps."""
        out = replace(self, before=tuple(dict(own) for own in self.before))
        out.require(first, then, why)
        return out

    def order(self) -> tuple[int, ...] | None:
        """Return the first feasible order in lexicographic order of step numbers, None for a cycle.

        An exception: while a part is held, the steps that lead to its release come first.
        """
        done = self._greedy_schedule()
        return done if len(done) == len(self.before) else None

    def explained(self, lacks: Callable[[Collection[int]], str] | None = None) -> str:
        """Return a text on why there is no order.

        Args:
            lacks: returns a text on the connection that is missing between given steps, which need one of each
                other, and the structure.
        """
        done = set(self._greedy_schedule())
        stuck = [k for k in range(len(self.before)) if k not in done]
        chain = [stuck[0]]
        while chain[-1] not in chain[:-1]:
            waits = [k for k in self.before[chain[-1]] if k not in done]
            if not waits:
                others = ", ".join(
                    self.words[k] for k in sorted(self.any_of[chain[-1]])
                )
                text = (
                    f"  {self.words[chain[-1]]} needs one of these before it: {others}"
                )
                # All direct and indirect predecessors, alternatives included.
                together = _reached(
                    [chain[-1]], lambda k: self.any_of[k] | self.before[k].keys()
                )
                return text + ("" if lacks is None else lacks(sorted(together)))
            chain.append(min(waits))
        circle = chain[chain.index(chain[-1]) :]
        return "\n".join(
            f"  {self.words[then]} comes after {self.words[first]}: {self.before[then][first]}"
            for then, first in pairwise(circle)
        )

    def _greedy_schedule(self) -> tuple[int, ...]:
        """Return the steps of a greedy schedule until none is ready."""
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
            urgent = (
                k
                for chain in self._release_prerequisites(done)
                for k in ready
                if k in chain
            )
            step = next(urgent, ready[0])
            out.append(step)
            done.add(step)

    def _release_prerequisites(self, done: set[int]) -> list[set[int]]:
        """Return the steps that lead to the release of each held part, fewest first."""
        chains = [
            _reached([end], lambda k: self.before[k].keys() - done)
            for placed, ends in self.closing.items()
            if placed in done and ends.isdisjoint(done)
            for end in ends
        ]
        return sorted(chains, key=lambda chain: (len(chain), min(chain)))


def _reached(
    start: Iterable[Item], after: Callable[[Item], Collection[Item]]
) -> set[Item]:
    """Return all nodes reachable from some nodes, these included, given the successors of each."""
    found = set(start)
    front = list(found)
    while front:
        new = set(after(front.pop())) - found
        found |= new
        front += new
    return found
