"""Check of given steps: the structure must stand after each, and bear every press on the way.

A sequence that the planner finds is made so (``sequencing``); one that a person wrote is checked
here, step by step, with the same equilibrium and the same insertion force.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice, product

from planning.errors import InfeasibleStepError
from planning.lego.bricks.assembly import LegoAssembly, LegoStep, Press, Support
from planning.lego.bricks.catalogue import brick_type
from planning.lego.bricks.grips import presses
from planning.lego.sequencing.finished_structure import finished_structure, scaffold
from planning.lego.sequencing.insertion import FROM_BELOW, SUPPORTED, InsertionRules
from planning.lego.sequencing.sequencing import SequencingRules
from planning.lego.stability.partial_structures import Names, PartialStructures
from planning.lego.stability.stability import StabilityReport

_HINTS = 3
"""How many grips or supports that would do are named."""

_MOST = 6
"""How many steps that will not do are named."""


def stable_steps(
    assembly: LegoAssembly, rules: SequencingRules | None = None
) -> LegoAssembly:
    """Return an assembly whose steps offer only the grips and supports that the structure bears.

    Args:
        assembly: with its steps; they overlap nowhere and none is in the air.
        rules: force and strength, and whether supports may be proposed.

    Returns:
        The same assembly; where a step leaves grips or supports to choose from, those under
        which the structure would give way are left out.

    Raises:
        InfeasibleStepError: the structure does not stand after a step, or gives way under the
            press of a step with any of its grips and supports; names each such step, why, and
            what would do.
    """
    rules = rules or SequencingRules()
    bricks = finished_structure(assembly)
    fixed = scaffold(assembly)
    checker = _StepChecker(
        assembly,
        PartialStructures([*bricks, *fixed]),
        rules,
    )
    names = frozenset(item.name for item in fixed)
    steps, faults = [], []
    for number, (step, brick) in enumerate(
        zip(assembly.steps, bricks, strict=True), start=1
    ):
        names |= {brick.name}
        narrowed = checker.narrowed(names, brick.name, step)
        if isinstance(narrowed, str):
            faults.append(f"step {number} ({step.words}): {narrowed}")
        else:
            steps.append(narrowed)
    if faults:
        more = len(faults) - _MOST
        shown = [*faults[:_MOST], *([f"and {more} more steps"] if more > 0 else [])]
        raise InfeasibleStepError("\n".join(shown))
    return replace(assembly, steps=tuple(steps))


class _StepChecker:
    """Judges the steps of one assembly."""

    def __init__(
        self,
        assembly: LegoAssembly,
        structures: PartialStructures,
        rules: SequencingRules,
    ) -> None:
        self._assembly = assembly
        self._structures = structures
        self._rules = rules
        self._insertion = InsertionRules(structures, force=rules.force)

    def narrowed(self, names: Names, brick: str, step: LegoStep) -> LegoStep | str:
        """Return a step with what the structure bears, or why it bears nothing.

        Args:
            names: the partial structure with the brick in place.
            brick: the brick.
            step: the step that places it.
        """
        standing = self._structures.standing(names)
        if not standing.stable:
            return f"the structure does not stand after it: {self._weakness(standing)}"
        grips, supports = self._grips(step), self._supports(step)

        def bears(press: Press, support: Support | None) -> bool:
            return self._report(names, brick, step, press, support).stable

        pairs = product(supports, grips)
        pair = next(((p, s) for s, p in pairs if bears(p, s)), None)
        if pair is None:
            return self._why_not(names, brick, step, grips, supports)
        press, support = pair
        with_support = [p for p in grips if p != press and bears(p, support)]
        with_press = [s for s in supports if s != support and bears(press, s)]
        if len(with_support) + 1 == len(grips) and len(with_press) + 1 == len(supports):
            return step
        return replace(
            step,
            press=press,
            presses=(press, *with_support),
            support=support,
            supports=tuple(s for s in (support, *with_press) if s is not None),
        )

    def _grips(self, step: LegoStep) -> tuple[Press, ...]:
        if step.press is None:
            return presses(brick_type(step.brick, self._assembly.bricks))
        return step.presses or (step.press,)

    def _supports(self, step: LegoStep) -> tuple[Support | None, ...]:
        return step.supports or (step.support,)

    def _report(
        self,
        names: Names,
        brick: str,
        step: LegoStep,
        press: Press,
        support: Support | None,
    ) -> StabilityReport:
        return self._insertion.bears(names, brick, press, support, up=step.up)

    def _why_not(
        self,
        names: Names,
        brick: str,
        step: LegoStep,
        grips: Sequence[Press],
        supports: Sequence[Support | None],
    ) -> str:
        """Return why no grip and support of a step will do, and what would."""
        report = self._report(names, brick, step, grips[0], supports[0])
        held = "" if supports[0] is None else " in spite of its support"
        side = "below" if step.up else "above"
        text = (
            f"the structure gives way under the press of {self._rules.force:g} N from {side}"
            f"{held}: {self._weakness(report)}"
        )
        other = self._better_grips(names, brick, step, grips, supports)
        if other:
            text += "; it would bear press " + " or ".join(other)
        better = self._better_supports(names, brick, step, grips)
        if better:
            return f"{text}; it would bear the press with support {' or '.join(better)}"
        if not step.up and not self._rules.support:
            return f"{text}; a support is not allowed"
        return text if other else f"{text}; no support that has room would help"

    def _better_grips(
        self,
        names: Names,
        brick: str,
        step: LegoStep,
        grips: Sequence[Press],
        supports: Sequence[Support | None],
    ) -> list[str]:
        kind = brick_type(step.brick, self._assembly.bricks)
        found = (
            f"{{side: {press.side}, offset: {press.offset}}}"
            for press in presses(kind)
            if press not in grips
            and self._report(names, brick, step, press, supports[0]).stable
        )
        return list(islice(found, _HINTS))

    def _better_supports(
        self, names: Names, brick: str, step: LegoStep, grips: Sequence[Press]
    ) -> list[str]:
        if not step.up and not self._rules.support:
            return []
        way = FROM_BELOW if step.up else SUPPORTED
        found = (
            f"{{at: [{s.x}, {s.y}, {s.z}], orientation: {s.orientation}}}"
            for press in grips
            for insertion in self._insertion.supported(names, brick, way, press)
            if (s := insertion.support) is not None
        )
        return list(islice(dict.fromkeys(found), _HINTS))

    def _weakness(self, report: StabilityReport) -> str:
        name = report.brick or ""
        item = self._structures.bricks.get(name)
        what = name if item is None else f"the {item.brick.name} of {name}"
        if math.isinf(report.score):
            return f"no forces of its knobs keep {what} in balance"
        return f"{what} needs {report.score:.2f} times the friction that its knobs have"
