"""The part graph: contacts in place, and which part may be placed when (V-A1, eq. 6)."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from graphlib import TopologicalSorter

import numpy as np

from planning.contacts.contact_graph import Lying, lowest, near_to
from planning.errors import ConstructionError
from planning.transforms import Array, translation

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
