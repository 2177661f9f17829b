"""Balance of an assembly: it must stand after every step, and in every state that can be reached.

Parts stand in their places by contact and friction, or because they are joined to what they touch
(``planning.statics``). What is fixed, and parts that no step moves, are the ground.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

from planning.cell.workcell import CellObject, Fixture, Workcell
from planning.errors import InfeasibleStepError
from planning.parts.part_steps import PartStep, WorkStep
from planning.statics.build_order import BuildStep, Fall, Waits, waits_for_balance
from planning.statics.joined import BalanceRules, Joined
from planning.statics.standing import Joint, PlacedBody, Standing
from planning.transforms import Transform

DENSITY = 1000.0
"""Of a part whose mass is not given [kg/m^3]."""

_MOST_NAMED = 4
"""How many parts that would be held are named."""


class PartBalance:
    """Tells whether an assembly stands in every state that its steps can lead to.

    Args:
        cell: its fixtures, and the parts that no step places, are the ground.
        steps: in their order.
        rules: friction, joints.
    """

    def __init__(
        self,
        cell: Workcell,
        steps: Sequence[PartStep | WorkStep],
        rules: BalanceRules,
    ) -> None:
        self._steps, self._rules = steps, rules
        self._number = {
            s.part.name: k for k, s in enumerate(steps) if isinstance(s, PartStep)
        }
        ground = {item.name: _body(item, item.pose) for item in cell.fixtures}
        ground |= {
            item.name: _body(item, item.start)
            for item in cell.objects
            if item.name not in self._number and not item.later
        }
        bodies = {
            s.part.name: _body(s.part, s.goal) for s in steps if isinstance(s, PartStep)
        }
        self._standing = Standing(bodies, ground, rules.standing)
        build, joining = _build_steps(steps, self._number, rules.joined)
        found = waits_for_balance(
            self._standing, build, {*joining, *_known_waits(steps, self._number)}
        )
        self.fall = found if isinstance(found, Fall) else None
        """The first state in the order of the steps in which something falls, None for none."""
        self._waits = joining if isinstance(found, Fall) else found | joining

    def waits(self) -> Waits:
        """Return which steps, from 0, must wait for which, so that everything always stands.

        Raises:
            InfeasibleStepError: something falls even in the given order; says what would help.
        """
        if self.fall is not None:
            raise InfeasibleStepError(self.refusal(self.fall))
        return self._waits

    def props(self, fall: Fall) -> list[str]:
        """Return the parts placed later each of which would keep everything standing."""
        now = [name for name, k in self._number.items() if k <= fall.step]
        return [
            name
            for name, k in self._number.items()
            if k > fall.step and self._standing.falling([*now, name]) is None
        ]

    def refusal(self, fall: Fall) -> str:
        """Return what falls, why, and what would help."""
        at, body, standing = fall.step, fall.body, self._rules.standing
        pairs = [pair for pair in self._standing.patches if body in pair]
        touched = {name for pair in pairs for name in pair} - {body}
        there = sorted(name for name in touched if self._number.get(name, -1) <= at)
        why = f"no forces between it and {', '.join(there)} keep it in balance"
        text = (
            f"step {at + 1} ({self._steps[at].step.words}): {body} would not stand after it: "
            f"{why if there else 'it touches nothing that is there'} (friction"
            f" {standing.friction:g}, gravity tilted by {math.degrees(standing.tilt):g}"
            " degrees)"
        )
        helps = []
        if there:
            helps.append(f"join it to what it lies on (joined: [[{there[0]}, {body}]])")
        if props := self.props(fall):
            helps.append(f"place {' or '.join(props[:_MOST_NAMED])} before")
        if fall.holds:
            held = " or ".join(fall.holds[:_MOST_NAMED])
            helps.append(f"hold {held} until it is joined")
        return text + ("; " + ", or ".join(helps) if helps else "")


def balance_groups(
    steps: Sequence[PartStep | WorkStep], rules: BalanceRules, leaves: Collection[int]
) -> Iterator[tuple[int, Sequence[PartStep | WorkStep], BalanceRules]]:
    """Yield steps that build something together, and the rules for it.

    Args:
        steps: of all products, in their order.
        rules: for all of them.
        leaves: numbers of the steps, from 1, after which all that is built leaves the cell.

    Yields:
        The number of the first step, from 0, the steps, and the rules.
    """
    placed = {s.part.name for s in steps if isinstance(s, PartStep)}
    cuts = [0, *sorted(leaves), len(steps)]
    for first, stop in pairwise(cuts):
        own = steps[first:stop]
        if not own:
            continue
        others = placed - {s.part.name for s in own if isinstance(s, PartStep)}
        joined = tuple(
            item
            for item in rules.joined
            if others.isdisjoint((item.joint.first, item.joint.second))
        )
        yield first, own, replace(rules, joined=joined)


def balance_waits(
    cell: Workcell,
    steps: Sequence[PartStep | WorkStep],
    rules: BalanceRules,
    leaves: Collection[int],
) -> Waits:
    """Return which steps, from 0, must wait for which, so that every product always stands.

    Raises:
        InfeasibleStepError: something falls even in the given order; says what would help.
    """
    return frozenset(
        (first + a, first + b)
        for first, own, rule in balance_groups(steps, rules, leaves)
        for a, b in PartBalance(cell, own, rule).waits()
    )


def _known_waits(
    steps: Sequence[PartStep | WorkStep], number: Mapping[str, int]
) -> Iterator[tuple[int, int]]:
    """Yield which steps wait for which in any plan (see ``waits``)."""
    named = {step.step.name: k for k, step in enumerate(steps)}
    for k, step in enumerate(steps):
        yield from ((named[name], k) for name in step.step.after)
        touched = step.at_goal if isinstance(step, PartStep) else step.touched
        for name in touched:
            if number.get(name, k) < k:
                yield number[name], k


def _build_steps(
    steps: Sequence[PartStep | WorkStep],
    number: Mapping[str, int],
    joined: Iterable[Joined],
) -> tuple[list[BuildStep], Waits]:
    """Return what each step does to the structure, and what waits because of joints."""
    named = {step.step.name: k for k, step in enumerate(steps)}
    joints: dict[int, list[Joint]] = {k: [] for k in range(len(steps))}
    waits = set()
    for item in joined:
        ends = [number[n] for n in (item.joint.first, item.joint.second) if n in number]
        at = max([*ends, *([] if item.by is None else [named[item.by]])], default=0)
        joints[at].append(item.joint)
        waits |= {(end, at) for end in ends if end < at}
    adds = [(s.part.name,) if isinstance(s, PartStep) else () for s in steps]
    build = [BuildStep(add, tuple(joints[k])) for k, add in enumerate(adds)]
    return build, frozenset(waits)


def _body(item: CellObject | Fixture, pose: Transform) -> PlacedBody:
    shape = item.shape
    mass = item.mass if isinstance(item, CellObject) else 0.0
    return PlacedBody(
        item.name,
        shape.pieces,
        pose,
        mass or DENSITY * shape.volume,
        shape.centre_of_mass,
    )
