"""Order and straight insertions of the bodies of an assembly, found by disassembly.

From the finished assembly, bodies are removed one by one, each along a straight line on which nothing that remains is
in its way. What is free stays free when others are removed, so the search never has to go back. Where no
body is free, the bodies that are in each other's way along a direction are the strongly connected components of a
graph (Wilson and Latombe, 1994). One that nothing else blocks is removed as a sub-assembly, and is taken apart by itself.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import NamedTuple

import networkx as nx
import numpy as np

from planning.disassembly.blocking import Blocking
from planning.disassembly.body import AssemblyBody
from planning.disassembly.directions import (
    different,
    face_directions,
    main_directions,
    most_common,
    spread_directions,
)
from planning.disassembly.fits import BodyFit, find_fits
from planning.disassembly.standing_states import BodyHold, StandingStates
from planning.disassembly.surface_contacts import surface_contacts
from planning.errors import RequestError, TwinError, format_names
from planning.statics.standing_rules import StandingRules
from planning.transforms import Array, frame_along

UP = (0.0, 0.0, 1.0)

_TOUCH = 5e-4
"""Distance up to which faces touch [m]."""

_NEAR = 1e-3
"""Bodies with boxes that are no farther apart are neighbours [m]."""

_MOST_BODIES = 200
"""Greatest number of bodies of an assembly."""

_MOST_TILTED = 50
"""Greatest number of bodies whose balance is checked with gravity tilted, not only upright."""

_MOST_PAIRS = 8
"""Greatest number of pairs that a message names."""


class InterlockedError(TwinError):
    """Bodies that no straight motions take apart.

    Attributes:
        bodies: names of the bodies of a smallest group that is locked.
        blocking: pairs of them, the first is in the way of the second along some direction.
        directions: number of directions that were tried.
    """

    def __init__(
        self, bodies: Sequence[str], blocking: Sequence[tuple[str, str]], tried: int
    ) -> None:
        self.bodies, self.blocking = tuple(bodies), tuple(blocking)
        self.directions = tried
        pairs = [f"{a} blocks {b}" for a, b in self.blocking]
        super().__init__(
            f"{', '.join(bodies)} hold each other: along none of {tried} directions can one, or"
            f" several as one, be moved out straight ({format_names(pairs, _MOST_PAIRS)}); split one of them, or export"
            " them as one body"
        )


@dataclass(frozen=True)
class StraightInsertion:
    """A straight insertion of a body, or of a sub-assembly as one.

    Attributes:
        bodies: their names, several for a sub-assembly.
        direction: unit vector along which they are moved in, in the frame of the assembly.
        distance_m: length of the straight motion from where they are clear of everything else.
        after: names of the bodies that must be in place before, without the base and without those
            that others of them need.
        inner: of a sub-assembly: how it is put together before, the body that the others are added to first.
    """

    bodies: tuple[str, ...]
    direction: tuple[float, float, float]
    distance_m: float
    after: tuple[str, ...] = ()
    inner: AssemblyPlan | None = None


@dataclass(frozen=True)
class AssemblyPlan:
    """How an assembly is put together.

    Attributes:
        base: name of the body that is there first, and stays where it is.
        steps: insertions of all others, in an order that is possible.
        fits: pins in bores, and tongues in slots.
        holds: what does not stand by itself.
    """

    base: str
    steps: tuple[StraightInsertion, ...]
    fits: tuple[BodyFit, ...] = ()
    holds: tuple[BodyHold, ...] = ()


def plan_assembly(
    bodies: Sequence[AssemblyBody], base: str, *, up: Sequence[float] = UP
) -> AssemblyPlan:
    """Return an order and straight insertions of the bodies of an assembly.

    Args:
        bodies: in their places, with different names.
        base: name of the one that is there first.
        up: direction against gravity in the frame of the assembly.

    Raises:
        ShapeError: a mesh cannot be used, or two bodies overlap.
        InterlockedError: the bodies cannot be taken apart by straight motions.
        RequestError: a name is there twice, that of the base is unknown, or there are too many bodies.
    """
    names = [body.name for body in bodies]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise RequestError(f"several bodies are called {', '.join(twice)}")
    if len(names) > _MOST_BODIES:
        raise RequestError(
            f"there are {len(names)} bodies, more than {_MOST_BODIES}: export groups of them"
            " that are put together before as one body each"
        )
    if base not in names:
        raise RequestError(f"there is no body {base}", choices=tuple(names))
    search = _Disassembly(bodies, np.array(up, dtype=float) / np.linalg.norm(up))
    fits = find_fits(search.blocking, search.patches)
    return replace(search.plan(names, base), fits=fits)


class _Removal(NamedTuple):
    """Bodies that are moved out as one, and the direction."""

    bodies: tuple[str, ...]
    direction: Array


class _Disassembly:
    """Takes bodies apart, in thought."""

    def __init__(self, bodies: Sequence[AssemblyBody], up: Array) -> None:
        self.blocking = Blocking(bodies)
        self._up = up
        self._bodies = {body.name: body for body in bodies}
        self.patches = surface_contacts(self.blocking, _TOUCH)
        names, near = self.blocking.names, self.blocking.near
        surfaces = self.blocking.surfaces
        own = {name: face_directions(surfaces[name]) for name in names}
        self._directions = {}
        for name in names:
            beside = (own[n] for n in names if n != name and near(name, n, _NEAR))
            found = self._sorted([*own[name], *most_common(beside)])
            self._directions[name] = found
        self._common = self._sorted(most_common(own.values()))
        self._all = different([*self._common, *spread_directions()])
        self._height = {n: float((s.vertices @ up).max()) for n, s in surfaces.items()}
        self._volume = {body.name: abs(float(body.mesh.volume)) for body in bodies}
        self._witness: dict[tuple[str, bytes], str] = {}

    def _sorted(self, axes: Iterable[Array]) -> list[Array]:
        """Return directions and their opposites, the main ones too, those that are closest to up first."""
        both = (sign * axis for axis in axes for sign in (1.0, -1.0))
        found = different([*main_directions(self._up), *both])
        order = np.argsort(-np.round(np.array(found) @ self._up, 6), kind="stable")
        return [found[k] for k in order]

    def plan(self, names: Collection[str], base: str) -> AssemblyPlan:
        """Return how some of the bodies are put together, however the others are."""
        frame, rules = frame_along(self._up), StandingRules()
        if len(names) > _MOST_TILTED:
            rules = replace(rules, tilt=0.0)
        own = [self._bodies[name] for name in names]
        states = StandingStates(own, self.patches, base, frame, rules)
        remaining = dict.fromkeys(names)
        removed: list[_Removal] = []
        while len(remaining) > 1:
            removed.append(self._removable(remaining, base, states))
            for name in removed[-1].bodies:
                del remaining[name]
        removed.reverse()
        groups = [removal.bodies for removal in removed]
        holds = states.holds(groups)
        order = self._precedence(removed)
        order.add_edges_from(states.waits(groups, list(order.edges), holds))
        needed = nx.transitive_reduction(order)
        steps = []
        for k, removal in enumerate(removed):
            later = {n for m in nx.descendants(order, k) for n in groups[m]}
            there = [n for n in names if n not in later and n not in removal.bodies]
            length = max(
                self.blocking.clear_length(name, there, removal.direction)
                for name in removal.bodies
            )
            inner = None
            if len(removal.bodies) > 1:
                first = max(removal.bodies, key=self._volume.__getitem__)
                inner = self.plan(removal.bodies, first)
            x, y, z = (-removal.direction + 0.0).tolist()
            after = tuple(n for m in sorted(needed.predecessors(k)) for n in groups[m])
            steps.append(
                StraightInsertion(removal.bodies, (x, y, z), length, after, inner)
            )
        return AssemblyPlan(base, tuple(steps), holds=holds)

    def _removable(
        self, remaining: Mapping[str, None], base: str, states: StandingStates
    ) -> _Removal:
        """Return what is removed next: what leaves the rest standing, upwards where possible, the highest first."""
        found: list[tuple[float, float, str, Array]] = []
        for directions in (self._directions, dict.fromkeys(remaining, self._all)):
            for name in remaining:
                if name == base:
                    continue
                free = self._free(name, remaining, directions[name])
                if (direction := next(free, None)) is not None:
                    steep = round(float(direction @ self._up), 6)
                    found.append((steep, self._height[name], name, direction))
            if found:
                break
        if not found:
            return self._sub_assembly(remaining, base)
        found.sort(key=lambda item: item[:2], reverse=True)
        enough, least = states.falling(remaining), len(remaining)
        *_, best, along = found[0]
        for *_, name, direction in found:
            falling = states.falling(remaining.keys() - {name})
            if falling < least:
                best, along, least = name, direction, falling
            if falling <= enough:
                break
        return self._shortest(best, along, remaining)

    def _shortest(
        self, name: str, along: Array, remaining: Mapping[str, None]
    ) -> _Removal:
        """Return the removal of a body along the direction as steep as the given one that is clear soonest."""
        others = [other for other in remaining if other != name]
        up, own = self._up, self._directions[name]
        even = [d for d in own if abs(float(d @ up) - float(along @ up)) < 1e-6]
        free = list(self._free(name, remaining, even)) or [along]
        lengths = [self.blocking.clear_length(name, others, d) for d in free]
        return _Removal((name,), free[int(np.round(lengths, 4).argmin())])

    def _free(
        self, name: str, remaining: Mapping[str, None], directions: Sequence[Array]
    ) -> Iterator[Array]:
        """Yield directions along which nothing that remains is in the way of a body."""
        for direction in directions:
            key = name, direction.tobytes()
            if self._witness.get(key) in remaining:
                continue
            for other in remaining:
                if other != name and self.blocking.blocks(other, name, direction):
                    self._witness[key] = other
                    break
            else:
                yield direction

    def _graph(self, names: Iterable[str], direction: Array) -> nx.DiGraph[str]:
        """Return the graph with an edge from each body to those that are in its way."""
        graph: nx.DiGraph[str] = nx.DiGraph()
        graph.add_nodes_from(names)
        graph.add_edges_from(
            (one, other)
            for one, other in permutations(graph, 2)
            if self.blocking.blocks(other, one, direction)
        )
        return graph

    def _sub_assembly(self, remaining: Mapping[str, None], base: str) -> _Removal:
        """Return a group of bodies that can be removed as one, the smallest along common directions if there is one."""
        best: _Removal | None = None
        for number, direction in enumerate(self._all):
            if best is not None and (
                number == len(self._common) or len(best.bodies) == 2
            ):
                break
            parts = nx.condensation(self._graph(remaining, direction))
            for part, members in parts.nodes(data="members"):
                free = parts.out_degree(part) == 0 and base not in members
                if free and (best is None or len(members) < len(best.bodies)):
                    group = tuple(n for n in remaining if n in members)
                    best = _Removal(group, direction)
        if best is None:
            raise self._locked(list(remaining))
        return best

    def _locked(self, names: list[str]) -> InterlockedError:
        """Return the error about a group of bodies that is locked; no smaller one within it is."""
        graphs = [self._graph(names, direction) for direction in self._all]
        for name in list(names):
            rest = [other for other in names if other != name]
            if len(rest) > 1 and all(
                nx.is_strongly_connected(graph.subgraph(rest)) for graph in graphs
            ):
                names = rest
        pairs = [
            (other, one)
            for other, one in permutations(names, 2)
            if self.blocking.near(one, other, _NEAR)
            and any(graph.has_edge(one, other) for graph in graphs)
        ]
        return InterlockedError(names, pairs, len(self._all))

    def _precedence(self, removed: Sequence[_Removal]) -> nx.DiGraph[int]:
        """Return which insertions must come before which, as the former could not be done after the latter."""
        graph: nx.DiGraph[int] = nx.DiGraph()
        graph.add_nodes_from(range(len(removed)))
        for (k, (own, direction)), (m, (others, _)) in permutations(
            enumerate(removed), 2
        ):
            pairs = product(others, own)
            if any(self.blocking.blocks(*pair, direction) for pair in pairs):
                graph.add_edge(k, m)
        return graph
