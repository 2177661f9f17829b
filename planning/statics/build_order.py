"""Whether a structure stands in every state that a build can come through, and what must wait for it.

Robots that wait only where they must put parts in place in many orders: every set of steps that
contains, with a step, all that it waits for can be what is there at some time. There may be
exponentially many of them, but forces can be added up. If the weight of a part can be carried down
to the ground through what is there *whenever* the part is (itself and the steps that it waits
for), and so for every part, then the sum of these forces balances any such set: pushes and forces
within cones of friction stay so when they are added. A part for which that does not hold needs
the weight, or the hold, of others. It is made to wait for all earlier steps, of which it is
checked that they stand together with it; any set with it in it then contains all of these, and
what comes on top is carried on its own as before. So one linear program or two a step (for each
tilt of gravity) decide about all states.

Joints that bear so much and no more spoil the sum: their forces add up to more than they bear.
Where there are any, steps of parts that hang together wait for each other in their order.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

import networkx as nx

from planning.statics.standing import Joint, Standing

Waits = frozenset[tuple[int, int]]


@dataclass(frozen=True)
class BuildStep:
    """What a step does to the structure.

    Attributes:
        adds: names of the bodies that are in place from then on.
        joins: what is joined from then on.
    """

    adds: tuple[str, ...] = ()
    joins: tuple[Joint, ...] = ()


@dataclass(frozen=True)
class Fall:
    """A state in which something falls.

    Attributes:
        step: number of the step after which it does, from 0.
        body: what falls.
        holds: bodies each of which would keep everything in balance if it were held.
    """

    step: int
    body: str
    holds: tuple[str, ...]


def waits_for_balance(
    standing: Standing, steps: Sequence[BuildStep], waits: Iterable[tuple[int, int]]
) -> Waits | Fall:
    """Return what steps must wait for beyond what they wait for anyway, or the first fall.

    Args:
        standing: knows the bodies in their places.
        steps: in their order; the structure has to stand after each of them.
        waits: pairs of step numbers from 0, (a, b) for b after a, each with a < b.

    Returns:
        Pairs like ``waits`` with which the structure stands in every state that is reachable;
        or a state that does not stand, of those that come up in the given order.
    """
    order: nx.DiGraph[int] = nx.DiGraph()
    order.add_nodes_from(range(len(steps)))
    order.add_edges_from(waits)
    together = _hanging_together(standing, steps)
    out: set[tuple[int, int]] = set()
    for k, step in enumerate(steps):
        mates = [n for n in range(k) if together[n] == together[k]]
        before = {*nx.ancestors(order, k), k}
        stepwise = any(
            not joint.endless for n in (*mates, k) for joint in steps[n].joins
        )
        if not stepwise and _carried(standing, steps, before, step.adds):
            continue
        everything = sorted({*before, *mates})
        body = _falling(standing, steps, everything)
        if body is not None:
            return Fall(k, body, _helping_holds(standing, steps, everything))
        new = [(n, k) for n in mates if n not in before]
        order.add_edges_from(new)
        out.update(new)
    return frozenset(out)


def _hanging_together(standing: Standing, steps: Sequence[BuildStep]) -> list[int]:
    """Return, for each step, a number that it shares with the steps whose bodies its own touch."""
    graph = standing.touching()
    for step in steps:
        graph.add_edges_from(
            (j.first, j.second)
            for j in step.joins
            if j.first in standing.bodies and j.second in standing.bodies
        )
    number = {
        name: k
        for k, names in enumerate(nx.connected_components(graph))
        for name in names
    }
    out = []
    for k, step in enumerate(steps):
        named = [*step.adds, *(n for j in step.joins for n in (j.first, j.second))]
        found = [number[name] for name in named if name in number]
        out.append(found[0] if found else -1 - k)
    return out


def _carried(
    standing: Standing,
    steps: Sequence[BuildStep],
    before: Collection[int],
    bodies: Collection[str],
) -> bool:
    """Return whether the weight of some bodies alone goes down through what is there before."""
    if not bodies:
        return True
    there, joints = _state(steps, before)
    return standing.falling(there, joints=joints, weighing=bodies) is None


def _falling(
    standing: Standing, steps: Sequence[BuildStep], done: Collection[int]
) -> str | None:
    there, joints = _state(steps, done)
    return standing.falling(there, joints=joints)


def _helping_holds(
    standing: Standing, steps: Sequence[BuildStep], done: Collection[int]
) -> tuple[str, ...]:
    there, joints = _state(steps, done)
    return tuple(
        name
        for name in there
        if standing.falling(there, joints=joints, held=(name,)) is None
    )


def _state(
    steps: Sequence[BuildStep], done: Collection[int]
) -> tuple[list[str], list[Joint]]:
    numbers = sorted(done)
    there = [name for k in numbers for name in steps[k].adds]
    return there, [joint for k in numbers for joint in steps[k].joins]
