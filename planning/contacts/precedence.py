"""What comes before what: contacts of parts where they lie, ways in, and the order that keeps it.

The part graph says what touches what in place and which part may be placed when (V-A1, eq. 6).
``StepPrecedence`` is filled with edges by who knows why one step comes before another, and gives
the order nearest to a list that keeps all of them, or the steps that wait for each other.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from graphlib import TopologicalSorter
from itertools import pairwise, product
from typing import Any

import numpy as np

from planning.cell.workcell import CellObject, Fixture, Workcell
from planning.errors import ConstructionError
from planning.geometry.exact import Solid, distance, place, resting_solid
from planning.transforms import Array, Transform, translation

Lying = tuple[CellObject | Fixture, Transform]
"""A thing and the pose of its frame in the world."""

_NOWHERE = np.zeros(0)
"""Configuration of what no robot carries."""


def near_to(
    part: Lying, others: Mapping[str, Lying], within: float
) -> dict[str, float]:
    """Return the entities near a part, with their distances.

    Args:
        part: where it lies.
        others: everything else, by name.
        within: what is further away than this is left out [m].

    Returns:
        Signed distances by name, negative for overlap [m].
    """
    low, high = bounds(part)
    out = {}
    for name, other in others.items():
        other_low, other_high = bounds(other)
        if np.any(low > other_high + within) or np.any(other_low > high + within):
            continue
        gap = _gap(part, other)
        if gap <= within:
            out[name] = gap
    return out


def nearest_to(part: Lying, others: Mapping[str, Lying]) -> tuple[str, float] | None:
    """Return the entity nearest to a part, and how far it is [m]; None where there is no other."""
    low, high = bounds(part)
    least = {
        name: float(np.linalg.norm(np.maximum(np.maximum(low - b, a - high), 0.0)))
        for name, (a, b) in ((k, bounds(other)) for k, other in others.items())
    }
    best: tuple[str, float] | None = None
    for name in sorted(others, key=least.__getitem__):
        if best is not None and least[name] > best[1]:
            break
        gap = _gap(part, others[name])
        if best is None or gap < best[1]:
            best = name, gap
    return best


def nearest_words(name: str, part: Lying, others: Mapping[str, Lying]) -> str:
    """Return in words what is nearest to a part, and how far it is."""
    found = nearest_to(part, others)
    if found is None:
        return f"nothing else is there by then to be near {name}"
    return f"nearest to {name} is {found[0]}, {found[1] * 1e3:.1f} mm away"


def _gap(one: Lying, other: Lying) -> float:
    """Return the signed distance of the nearest two pieces, the deepest overlap if any [m]."""
    pairs = product(_solids(one), _solids(other))
    return min(distance(a, pose_a, b, pose_b) for (a, pose_a), (b, pose_b) in pairs)


def _solids(lying: Lying) -> list[tuple[Solid, Any]]:
    """Return the pieces of what lies somewhere, each with its pose for coal."""
    item, pose = lying
    found = [resting_solid(item.name, body, pose) for body in item.shape.pieces]
    return [(solid, place(solid, _NOWHERE, _NOWHERE)[0]) for solid in found]


def standing(cell: Workcell) -> dict[str, Lying]:
    """Return the fixtures of a cell where they stand, by name."""
    return {item.name: (item, item.pose) for item in cell.fixtures}


def lowest(lying: Lying) -> float:
    """Return the height of the lowest corner of what lies somewhere [m]."""
    return float(bounds(lying)[0][2])


def bounds(lying: Lying) -> tuple[Array, Array]:
    """Return the least and greatest corners of the upright box around what lies somewhere [m]."""
    item, pose = lying
    return item.shape.bounds(pose)


TOUCH = 0.03
"""Parts that are nearer to each other than this touch: a joint with room to spare [m]."""

MOST_OVERLAP = 0.002
"""Deepest that a part may be in what it touches: rounding of poses in files [m]."""

NEAR = 0.002
"""Things this near to each other touch [m]: rounding, and the margin that planning keeps."""

_SINK = 0.01
"""A part is let sink by so much to find what it rests on [m]."""

_RESTS = 0.5
"""It rests on what then comes closer by more than this share of it."""

_STEP = 0.005
"""A straight way is looked at so often [m]."""


@dataclass(frozen=True)
class Overlaps:
    """Depths to which things may be in each other where they belong.

    Attributes:
        joined: pairs of names that are joined, such as bars that meet in a node.
        depth: of those; of all others it is ``MOST_OVERLAP`` [m].
    """

    joined: frozenset[frozenset[str]] = frozenset()
    depth: float = MOST_OVERLAP

    def most(self, first: str, second: str) -> float:
        """Return how deep two things may be in each other [m]."""
        if {first, second} in self.joined:
            return max(self.depth, MOST_OVERLAP)
        return MOST_OVERLAP


_ROUNDING = Overlaps()


@dataclass(frozen=True)
class PartGraph:
    """Contacts of the finished structure.

    Attributes:
        neighbours: part to the parts that it touches.
        ground: part to the fixtures that it touches; parts that stand on nothing fixed are
            left out.
        carriers: part to the neighbours that it rests on, and to those whose way in would lead
            through it: they come before it.
        covers: part to the parts that lie on it in the supply: they must be taken first. Parts
            that nothing lies on may be left out.
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
            carried: whether a part waits for everything that it rests on. Without, one placed
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
        reached = set(self.ground)
        front = list(reached)
        while front:
            new = self.neighbours[front.pop()] - reached
            reached |= new
            front += new
        return tuple(part for part in self.neighbours if part not in reached)

    def never_placeable(self, *, carried: bool = True) -> tuple[str, ...]:
        """Return the parts that wait for each other, whatever is placed before: see placeable."""
        placed: set[str] = set()
        while new := self.placeable(placed, carried=carried):
            placed.update(new)
        return tuple(part for part in self.neighbours if part not in placed)

    @cached_property
    def piled_on(self) -> Mapping[str, int]:
        """Part to how many others must follow it, one resting on the other."""
        out = dict.fromkeys(self.carriers, 0)
        for part in reversed(list(TopologicalSorter(self.carriers).static_order())):
            for below in self.carriers[part]:
                out[below] = max(out[below], out[part] + 1)
        return out


def build_part_graph(
    parts: Mapping[str, Lying],
    fixtures: Sequence[Lying],
    *,
    touch: float = TOUCH,
    covers: Mapping[str, frozenset[str]] | None = None,
    overlaps: Overlaps = _ROUNDING,
) -> PartGraph:
    """Find what touches what where every part is in its place.

    A part rests on a neighbour that it would come at least half as much nearer to as it sinks.

    Args:
        parts: every part in its place, by name.
        fixtures: what stands fast.
        touch: parts nearer to each other than this touch [m].
        covers: see PartGraph and ``stacked``.
        overlaps: how deep things may be in each other.

    Raises:
        ConstructionError: two parts, or a part and a fixture, would overlap.
    """
    grounds = {item.name: (item, pose) for item, pose in fixtures}
    neighbours, ground, carriers = {}, {}, {}
    for name, (item, pose) in parts.items():
        others = {key: value for key, value in parts.items() if key != name}
        near = near_to((item, pose), others | grounds, touch)
        for other, gap in near.items():
            if gap < -overlaps.most(name, other):
                raise ConstructionError(
                    f"{name} and {other} would overlap by {-gap * 1e3:.0f} mm where they belong"
                )
        neighbours[name] = frozenset(key for key in near if key in others)
        carriers[name] = _below((item, pose), others, near, touch)
        if fixed := frozenset(near) & frozenset(grounds):
            ground[name] = fixed
    return PartGraph(neighbours, ground, carriers, covers or {})


def with_insertions(
    graph: PartGraph,
    parts: Mapping[str, Lying],
    insertions: Mapping[str, Array],
    approach: float,
) -> PartGraph:
    """Return the graph in which a part also waits for those whose way in leads through it.

    Planning exempts from collisions what touches in place: it would not see that the way there
    leads through what it touches. Two that are in each other's way wait for each other, which
    ``never_placeable`` finds.

    Args:
        graph: the part graph.
        parts: every part in its place, by name.
        insertions: direction of the straight way in of each part, shape (3,).
        approach: length of that way [m].
    """
    carriers = dict(graph.carriers)
    for name, lying in parts.items():
        near = {k: parts[k] for k in sorted(graph.neighbours[name])}
        for other in near_to(lying, near, NEAR):
            settled = other in graph.carriers[name] or name in graph.carriers[other]
            if not settled and leads_through(
                lying, near[other], insertions[name], approach
            ):
                carriers[other] |= {name}
    return replace(graph, carriers=carriers)


def leads_through(
    lying: Lying,
    other: Lying,
    insertion: Array,
    approach: float,
    most: float = MOST_OVERLAP,
) -> bool:
    """Tell whether a part that comes to its place on a straight way is deeper than ``most`` in another one."""
    item, pose = lying
    for away in np.linspace(0.0, approach, int(np.ceil(approach / _STEP)) + 1)[1:]:
        before = (item, translation(*(-away * insertion)) @ pose)
        if any(gap < -most for gap in near_to(before, {"": other}, 0.0).values()):
            return True
    return False


def stacked(parts: Mapping[str, Lying]) -> dict[str, frozenset[str]]:
    """Return for parts in the supply what lies on them, those on which nothing does left out.

    Args:
        parts: every part where it lies at the start, by name.
    """
    bottom = {name: lowest(lying) for name, lying in parts.items()}
    floor = min(bottom.values(), default=0.0) + _SINK
    above: dict[str, set[str]] = {}
    for name, lying in parts.items():
        if bottom[name] > floor:
            others = {key: value for key, value in parts.items() if key != name}
            for below in _below(lying, others, near_to(lying, others, _SINK), _SINK):
                above.setdefault(below, set()).add(name)
    return {name: frozenset(found) for name, found in above.items()}


def _below(
    lying: Lying, others: Mapping[str, Lying], near: Mapping[str, float], touch: float
) -> frozenset[str]:
    """Return the parts near to a part to which it would come much nearer if it sank."""
    item, pose = lying
    sunk = (item, translation(0.0, 0.0, -_SINK) @ pose)
    close = {key: others[key] for key in near if key in others}
    gaps = near_to(sunk, close, touch)
    return frozenset(k for k, gap in gaps.items() if near[k] - gap > _RESTS * _SINK)


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

    def explained(self, lacks: Callable[[Collection[int]], str] | None = None) -> str:
        """Return in words why there is no order.

        Args:
            lacks: says what keeps steps, which need one of each other, from what stands.
        """
        done = set(self._doable())
        stuck = [k for k in range(len(self.before)) if k not in done]
        way = [stuck[0]]
        while way[-1] not in way[:-1]:
            waits = [k for k in self.before[way[-1]] if k not in done]
            if not waits:
                others = ", ".join(self.words[k] for k in sorted(self.any_of[way[-1]]))
                text = f"  {self.words[way[-1]]} needs one of these before it: {others}"
                return text + ("" if lacks is None else lacks(self._together(way[-1])))
            way.append(min(waits))
        circle = way[way.index(way[-1]) :]
        return "\n".join(
            f"  {self.words[then]} comes after {self.words[first]}: {self.before[then][first]}"
            for then, first in pairwise(circle)
        )

    def _together(self, step: int) -> list[int]:
        """Return a step and those that come before it or that it needs one of, and so on."""
        found, front = {step}, [step]
        while front:
            new = (self.any_of[front[-1]] | self.before[front.pop()].keys()) - found
            found |= new
            front += new
        return sorted(found)

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
        chains = []
        for placed, ends in self.closing.items():
            if placed not in done or not ends.isdisjoint(done):
                continue
            for end in ends:
                chain, front = {end}, [end]
                while front:
                    new = self.before[front.pop()].keys() - chain - done
                    chain |= new
                    front += new
                chains.append(chain)
        return sorted(chains, key=lambda chain: (len(chain), min(chain)))
