"""Stability of a structure in every state that a build can reach, and precedence constraints that ensure it.

Every set of steps that is closed under predecessors is a reachable state. There may be exponentially many such
sets, but one check per part is sufficient, because contact forces add up. If, for every part, the bodies that are
always present together with it (itself and its predecessors) can carry its weight to the ground, then the sum of
these forces balances every such set. Pushes and forces within friction cones remain admissible when added.
A part that fails the check needs the weight, or the support, of other parts. It waits for all earlier steps, and
is checked together with them. Any set that contains it then contains all of these, and later parts are checked
separately as before. One or two linear programs per step and tilt direction therefore cover all states.

Joints of limited strength break this argument, because the summed forces may exceed the strength. If there are
such joints, the steps of connected parts wait for each other in their order.

The robot that places a part may hold it until a later step is complete. Until then the hand carries the part and
what rests on it; afterwards, predecessors of that step carry its weight. A part that may rest on a held part is
checked with that part held and released. A part that would fall is held until a later step joins it, if any does.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, combinations

import networkx as nx

from planning.statics.standing import StabilityChecker
from planning.statics.standing_rules import Joint

Waits = frozenset[tuple[int, int]]

_MOST_OPEN = 4
"""Greatest number of held parts whose releases are combined; more are treated as one."""


@dataclass(frozen=True)
class BuildStep:
    """Bodies and joints that a step adds to the structure.

    Attributes:
        adds: names of the bodies that are in place from then on.
        joins: what is joined from then on.
        until: number of the step until which its bodies are held, None for not at all.
    """

    adds: tuple[str, ...] = ()
    joins: tuple[Joint, ...] = ()
    until: int | None = None


@dataclass(frozen=True)
class StableBuild:
    """A build that is stable in every state.

    Attributes:
        waits: additional precedences of steps.
        keeps: by step that adds a body, the step until which its robot holds it.
    """

    waits: Waits
    keeps: Mapping[int, int] = field(default_factory=dict)


@dataclass(frozen=True)
class UnstableState:
    """A state in which something falls.

    Attributes:
        step: number of the step after which it does, from 0.
        body: what falls.
        holds: bodies that come into play with that step, and what falls: those each of which
            would keep everything in balance if it were held.
        held: what is in hands then.
    """

    step: int
    body: str
    holds: tuple[str, ...]
    held: tuple[str, ...] = ()


def balance_dependencies(
    standing: StabilityChecker,
    steps: Sequence[BuildStep],
    waits: Iterable[tuple[int, int]],
    keepable: Collection[str] | None = None,
) -> StableBuild | UnstableState:
    """Return additional step precedences for stability, or the first fall.

    Args:
        standing: knows the bodies in their places.
        steps: in their order; the structure has to stand after each of them.
        waits: pairs of step numbers from 0, (a, b) for b after a, each with a < b.
        keepable: bodies that may be held until a later step joins them where they would
            fall; any by default.

    Returns:
        Pairs like ``waits`` with which the structure stands in every state that is reachable;
        or a state that does not stand, of those that come up in the given order.
    """
    build = _Build(standing, steps, waits, keepable)
    for k in range(len(steps)):
        while (fall := build.fall(k)) is not None:
            if not build.keep(fall):
                return fall
    return build.stand()


class _Build:
    """Checks the steps of a build in their order."""

    def __init__(
        self,
        standing: StabilityChecker,
        steps: Sequence[BuildStep],
        waits: Iterable[tuple[int, int]],
        keepable: Collection[str] | None,
    ) -> None:
        self._standing, self._steps, self._keepable = standing, steps, keepable
        self._until = {k: s.until for k, s in enumerate(steps) if s.until is not None}
        self._order: nx.DiGraph[int] = nx.DiGraph()
        self._order.add_nodes_from(range(len(steps)))
        self._order.add_edges_from(waits)
        self._order.add_edges_from(self._until.items())
        self._together = _contact_groups(standing, steps)
        self._whole: set[int] = set()
        self._new: set[tuple[int, int]] = set(self._until.items())

    def stand(self) -> StableBuild:
        """Return the precedences and holds found so far."""
        return StableBuild(frozenset(self._new), dict(self._until))

    def fall(self, k: int) -> UnstableState | None:
        """Return what falls after a step; add precedences that prevent it where possible."""
        mates = [n for n in range(k) if self._together[n] == self._together[k]]
        before = {*nx.ancestors(self._order, k), k}
        stepwise = any(
            not joint.is_unlimited
            for n in (*mates, k)
            for joint in self._steps[n].joins
        )
        if not stepwise and k not in self._whole and self._carried(k, before):
            return None
        everything = {*before, *mates}
        held = self._held(everything)
        there, joints = _state(self._steps, everything)
        body = self._standing.falling(there, joints=joints, held=held)
        if body is not None:
            new_ones = [*self._steps[k].adds, *self._let_go(k), body]
            holds = tuple(
                name
                for name in dict.fromkeys(new_ones)
                if name not in held
                and self._standing.falling(there, joints=joints, held=(*held, name))
                is None
            )
            return UnstableState(k, body, holds, held)
        new = [(n, k) for n in mates if n not in before]
        self._order.add_edges_from(new)
        self._new.update(new)
        # What was balanced with these in hands is looked at again when hands let go.
        self._whole |= {
            last for n in everything if (last := self._until.get(n, -1)) > k
        }
        return None

    def _carried(self, k: int, before: Collection[int]) -> bool:
        """Return whether the bodies to be supported from a step on are, by its predecessors alone."""
        loads = () if k in self._until else self._steps[k].adds
        loads = (*loads, *self._let_go(k))
        if not loads:
            return True
        in_hands = sorted(n for n in before if self._until.get(n, k) not in before)
        if len(in_hands) > _MOST_OPEN:
            return False
        return all(
            self._standing.falling(
                there, joints=joints, held=held, weighing=frozenset(loads)
            )
            is None
            for there, joints, held in self._cases(before, in_hands)
        )

    def _cases(
        self, before: Collection[int], in_hands: Sequence[int]
    ) -> Iterator[tuple[list[str], list[Joint], tuple[str, ...]]]:
        """Yield sets of present, joined and held bodies, over all possible releases."""
        for count in range(len(in_hands) + 1):
            for gone in combinations(in_hands, count):
                done = set(before)
                for n in gone:
                    last = self._until[n]
                    done |= {last, *nx.ancestors(self._order, last)}
                # Other parts in hands may be there or not: they are left out.
                others = {
                    n
                    for n in done - set(before)
                    if self._until.get(n, -1) not in done and n in self._until
                }
                there, joints = _state(self._steps, done - others)
                held = [n for n in in_hands if self._until[n] not in done]
                names = (name for n in held for name in self._steps[n].adds)
                yield there, joints, tuple(names)

    def _held(self, done: Collection[int]) -> tuple[str, ...]:
        """Return the bodies held once some steps are done."""
        return tuple(
            name
            for n, last in self._until.items()
            if n in done and last not in done
            for name in self._steps[n].adds
        )

    def _let_go(self, k: int) -> list[str]:
        """Return the bodies released after a step."""
        own = (self._steps[n].adds for n, last in self._until.items() if last == k)
        return list(chain.from_iterable(own))

    def keep(self, fall: UnstableState) -> bool:
        """Hold what falls, or would on release, until a later step joins it; tell whether there is one."""
        k = fall.step
        own = [k] if k not in self._until else []
        let_go = (n for n, last in self._until.items() if last == k)
        own += [n for n in let_go if self._steps[n].until is None]
        for n in own:
            names = self._steps[n].adds
            if len(names) != 1 or names[0] not in fall.holds:
                continue
            if self._keepable is not None and names[0] not in self._keepable:
                continue
            joins = ((m, j) for m, step in enumerate(self._steps) for j in step.joins)
            last = next((m for m, j in joins if m > k and names[0] in j.ends), None)
            if last is not None:
                self._until[n] = last
                self._order.add_edges_from({(n, last), (k, last)})
                self._new |= {(n, last), (k, last)}
                if k in self._whole:
                    self._whole.add(last)
                return True
        return False


def _contact_groups(
    standing: StabilityChecker, steps: Sequence[BuildStep]
) -> list[int]:
    """Return, for each step, the number of its group of steps with touching bodies."""
    graph = standing.touching()
    let_go: dict[int, list[str]] = defaultdict(list)
    for step in steps:
        ends = (joint.ends for joint in step.joins)
        graph.add_edges_from(pair for pair in ends if standing.bodies.keys() >= {*pair})
        if step.until is not None:
            let_go[step.until] += step.adds
    groups = enumerate(nx.connected_components(graph))
    number = {name: k for k, names in groups for name in names}
    out = []
    for k, step in enumerate(steps):
        named = [*step.adds, *(name for joint in step.joins for name in joint.ends)]
        found = [number[name] for name in (*named, *let_go[k]) if name in number]
        out.append(found[0] if found else -1 - k)
    return out


def _state(
    steps: Sequence[BuildStep], done: Collection[int]
) -> tuple[list[str], list[Joint]]:
    numbers = sorted(done)
    there = [name for k in numbers for name in steps[k].adds]
    return there, [joint for k in numbers for joint in steps[k].joins]
