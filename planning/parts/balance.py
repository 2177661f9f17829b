"""Stability of an assembly after every step and in every reachable state.

Parts rest in place by contact and friction, or because they are joined to the parts that they touch
(``planning.statics``). Fixed bodies, and parts that no step moves, count as ground.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TypeGuard

from planning.cell.workcell import Workcell
from planning.errors import InfeasibleStepError
from planning.parts.assembly import PartAssembly
from planning.parts.part_steps import KnownStep, PartStep
from planning.statics.build_order import (
    BuildStep,
    StableBuild,
    UnstableState,
    Waits,
    balance_dependencies,
)
from planning.statics.standing import StabilityChecker, body_at, ground_bodies
from planning.statics.standing_rules import Joint, StandingRules

_MOST_NAMED = 4
"""Largest number of supporting parts that a message names."""


def make_stability_check(
    cell: Workcell, steps: Sequence[KnownStep], rules: StandingRules
) -> StabilityChecker:
    """Return the stability checker of the parts of some steps in their places, in any order.

    Args:
        cell: its fixtures, and the parts that no step places, are the ground.
        steps: in any order.
        rules: friction.
    """
    bodies = {s.part.name: body_at(s.part, s.place) for s in steps if _builds(s)}
    ground = ground_bodies(cell, bodies)
    return StabilityChecker(bodies, ground, rules)


class PartBalance:
    """Checks stability of an assembly in every state that its steps can reach.

    Args:
        cell: its fixtures, and the parts that no step places, are the ground.
        steps: in their order.
        rules: friction, joints.
        standing: stability checker of the same steps in any order; None to make one.
        keepable: parts that robots may keep holding until they are joined; any by default.
    """

    def __init__(
        self,
        cell: Workcell,
        steps: Sequence[KnownStep],
        rules: StandingRules,
        standing: StabilityChecker | None = None,
        keepable: Collection[str] | None = None,
    ) -> None:
        self._cell, self._steps, self._rules = cell, steps, rules
        self._number = {s.part.name: k for k, s in enumerate(steps) if _builds(s)}
        self._named = {step.step.name: k for k, step in enumerate(steps)}
        self._standing = standing or make_stability_check(cell, steps, rules)
        joints, self._joining = self._joined()
        until = _planned_holds(steps)
        self._build = [
            BuildStep((s.part.name,) if _builds(s) else (), joints[k], until.get(k))
            for k, s in enumerate(steps)
        ]
        known = {*self._joining, *self._known_waits()}
        found = balance_dependencies(self._standing, self._build, known, keepable)
        self.fall = found if isinstance(found, UnstableState) else None
        """The first unstable state in the order of the steps, None if all are stable."""
        self._stable = (
            found if isinstance(found, StableBuild) else StableBuild(frozenset())
        )

    def stable_build(self) -> StableBuild:
        """Return the precedences of steps that stability needs, from 0, and until which step parts are held.

        Raises:
            InfeasibleStepError: something falls even in the given order; says what would help.
        """
        if self.fall is not None:
            raise InfeasibleStepError(
                self.refusal(self.fall),
                steps=[self.fall.step + 1],
                thing=self.fall.body,
            )
        ground = ground_bodies(self._cell, self._number)
        for k, step in enumerate(self._steps):
            # At an intermediate stop, other parts come and go: the part must be stable on the ground alone.
            if not isinstance(step, PartStep) or step.step.stop is None:
                continue
            body = body_at(step.part, step.place)
            others = {name: own for name, own in ground.items() if name != body.name}
            alone = StabilityChecker({body.name: body}, others, self._rules)
            if alone.falling([body.name]) is not None:
                raise InfeasibleStepError(
                    f"step {k + 1} ({step.step.words}): {body.name} would not stand there on"
                    f" fixtures alone (friction {self._rules.friction:g}), and what is put"
                    " down on its way must",
                    steps=[k + 1],
                    thing=body.name,
                )
        return replace(self._stable, waits=self._stable.waits | self._joining)

    def _joined(self) -> tuple[list[tuple[Joint, ...]], Waits]:
        """Return the joints of each step, and the step precedences that follow from them."""
        joints: list[tuple[Joint, ...]] = [()] * len(self._steps)
        waits = set()
        for joint in self._rules.joints:
            ends = [self._number[name] for name in joint.ends if name in self._number]
            by = [] if joint.by is None else [self._named[joint.by]]
            at = max([*ends, *by], default=0)
            joints[at] += (joint,)
            waits |= {(end, at) for end in ends if end < at}
        return joints, frozenset(waits)

    def _known_waits(self) -> Iterator[tuple[int, int]]:
        """Yield the step precedences that hold in any plan."""
        for k, step in enumerate(self._steps):
            before = (self._named.get(name) for name in step.step.after)
            yield from ((first, k) for first in before if first is not None)
            for name in step.touched:
                if self._number.get(name, k) < k:
                    yield self._number[name], k

    def props(self, fall: UnstableState) -> list[str]:
        """Return the later parts that would each keep everything stable.

        Only parts that touch the falling body are tried.
        """
        now = [name for name, k in self._number.items() if k <= fall.step]
        joints = [j for step in self._build[: fall.step + 1] for j in step.joins]
        touching = self._standing.touched_by(fall.body)
        return [
            name
            for name, k in self._number.items()
            if k > fall.step
            and name in touching
            and self._standing.falling([*now, name], joints=joints, held=fall.held)
            is None
        ]

    def refusal(self, fall: UnstableState) -> str:
        """Return a message: what falls, the reason, and possible remedies."""
        at, body = fall.step, fall.body
        now = [name for name, k in self._number.items() if k <= at]
        touched = self._standing.touched_by(body)
        there = sorted(n for n in touched if n in now or n not in self._number)
        text = (
            f"step {at + 1} ({self._steps[at].step.words}): {body} would not stand after it: "
            f"{self._standing.why(body, now)}"
        )
        helps = []
        if there:
            helps.append(f"join it to what it lies on (joined: [[{there[0]}, {body}]])")
        if props := self.props(fall):
            helps.append(f"place {' or '.join(props[:_MOST_NAMED])} before")
        if body in fall.holds:
            helps.append(
                f"let a later step join it (joined: {{parts: [.., {body}], by: STEP}}): then it is"
                " kept hold of until then by who places it"
            )
        return text + ("; " + ", or ".join(helps) if helps else "")


def balance_groups(
    steps: Sequence[KnownStep], rules: StandingRules, leaves: Collection[int]
) -> Iterator[tuple[int, Sequence[KnownStep], StandingRules]]:
    """Yield the steps of each product or group of products, and the rules for them.

    What a step waits for in an earlier group is complete by then, such as a batch of several products.

    Args:
        steps: of all products, in their order.
        rules: for all of them.
        leaves: numbers of the steps, from 1, after which all that is built leaves the cell.

    Yields:
        The number of the first step, from 0, the steps, and the rules.
    """
    placed = {s.part.name for s in steps if isinstance(s, PartStep)}
    for first, stop in pairwise([0, *sorted(leaves), len(steps)]):
        if own := steps[first:stop]:
            others = placed - {s.part.name for s in own if isinstance(s, PartStep)}
            named = {None, *(s.step.name for s in own)}
            joints = tuple(
                j for j in rules.joints if others.isdisjoint(j.ends) and j.by in named
            )
            yield first, own, replace(rules, joints=joints)


def stability_constraints(
    cell: Workcell, steps: Sequence[KnownStep], assembly: PartAssembly
) -> StableBuild:
    """Return step precedences and holds with which every product is always stable.

    If the assembly does not ask for stability, only the holds that its steps state are returned.

    Raises:
        InfeasibleStepError: something falls even in the given order; says what would help.
    """
    if assembly.balance is None:
        return StableBuild(frozenset(), _planned_holds(steps))
    waits: set[tuple[int, int]] = set()
    keeps: dict[int, int] = {}
    leaves = assembly.supply.leaves.keys()
    for first, own, rule in balance_groups(steps, assembly.balance, leaves):
        found = PartBalance(cell, own, rule).stable_build()
        waits |= {(first + a, first + b) for a, b in found.waits}
        keeps |= {first + k: first + last for k, last in found.keeps.items()}
    return StableBuild(frozenset(waits), keeps)


def _builds(step: KnownStep) -> TypeGuard[PartStep]:
    """Tell whether a step puts a part in its final place."""
    return isinstance(step, PartStep) and step.step.stop is None


def _planned_holds(steps: Sequence[KnownStep]) -> dict[int, int]:
    """Return, for steps from 0, until which step their part is held, where the assembly states it."""
    named = {s.step.name: k for k, s in enumerate(steps) if s.step.name is not None}
    return {
        k: named[s.step.until]
        for k, s in enumerate(steps)
        if isinstance(s, PartStep) and s.step.until is not None
    }
