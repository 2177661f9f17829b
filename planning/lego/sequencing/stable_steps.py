"""Stability check of a given sequence: whether the structure bears each step, and which joints fail first.

A sequence that the planner finds is stable after each step, and bears every press (``sequencing``). A sequence from a
user is checked here step by step, with the same equations of equilibrium and the same insertion force.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from itertools import islice, product
from typing import Any

from planning.errors import InfeasibleStepError, format_faults
from planning.lego.bricks.assembly import LegoAssembly, LegoStep, Press, Support
from planning.lego.bricks.brick_grips import legal_presses
from planning.lego.insertion.insertion import Insertions, InsertionSite
from planning.lego.insertion.rules import InsertionMethod, SequencingRules
from planning.lego.sequencing.removal import UnremovableBrick, find_unremovable_bricks
from planning.lego.stability.partial_structures import PartialStructures
from planning.statics.equilibrium import StabilityReport

_HINTS = 3
"""How many grips or supports that would do are named."""


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
            what would do. Or a temporary brick is shut in, where the rules do not allow that.
    """
    rules = rules or SequencingRules()
    bricks = assembly.structure
    insertions = Insertions.of(bricks, assembly.scaffold, rules)
    structures, names = insertions.structures, insertions.fixed
    steps, faults = [], []
    weak: list[int] = []
    for number, (step, brick) in enumerate(
        zip(assembly.steps, bricks, strict=True), start=1
    ):
        at = f"{brick.name} ({step.words})"
        names |= {brick.name}
        if not structures.stands(names):
            why = _weakness(structures.weakness(names), structures)
            faults.append(f"{at}: the structure does not stand after it: {why}")
            weak.append(number)
            continue
        site = insertions.at(names, brick.name, up=step.up)
        choice = StepChoices(step, site)
        stable = choice.stable()
        if stable is None:
            faults.append(f"{at}: {choice.why_not()}")
            weak.append(number)
        else:
            steps.append(stable)
    if rules.removable:
        faults += [item.words for item in _unremovable_steps(assembly)]
    if faults:
        raise InfeasibleStepError(format_faults(faults, what=" steps"), steps=weak)
    return replace(assembly, steps=tuple(steps))


def _unremovable_steps(assembly: LegoAssembly) -> tuple[UnremovableBrick, ...]:
    """Return the temporary bricks of an assembly's steps that can no longer be removed."""
    built = zip(assembly.structure, assembly.steps, strict=True)
    helpers = frozenset(item.name for item, step in built if step.temporary)
    return find_unremovable_bricks(assembly.structure, helpers)


@dataclass(frozen=True)
class StepChoices:
    """Grips and supports of one step, checked for stability.

    Attributes:
        step: the step.
        site: judges its presses.
    """

    step: LegoStep
    site: InsertionSite

    @property
    def grips(self) -> tuple[Press, ...]:
        """The grips to choose from."""
        return self.step.presses or legal_presses(self.site.item.brick)

    @property
    def supports(self) -> tuple[Support | None, ...]:
        """The supports to choose from, None for none."""
        return self.step.supports or (None,)

    def stable(self) -> LegoStep | None:
        """Return the step with its stable grips and supports, None where there are none."""
        grips, supports = self.grips, self.supports
        pairs = product(supports, grips)
        pair = next(((p, s) for s, p in pairs if self._bears(p, s)), None)
        if pair is None:
            return None
        press, support = pair
        with_support = [p for p in grips if p != press and self._bears(p, support)]
        with_press = [s for s in supports if s != support and self._bears(press, s)]
        if len(with_support) + 1 == len(grips) and len(with_press) + 1 == len(supports):
            return self.step
        return replace(
            self.step,
            presses=(press, *with_support),
            supports=tuple(s for s in (support, *with_press) if s is not None),
        )

    def why_not(self) -> str:
        """Return the reason why no grip and support suffices, and some that would."""
        bearing = self.site.bears(self.grips[0], self.supports[0])
        report = self.site.weakness(self.grips[0], self.supports[0])
        held = "" if self.supports[0] is None else " in spite of its support"
        side = "below" if self.step.up else "above"
        text = (
            f"the structure gives way under the press of {bearing.needed:.1f} N from {side}"
            f"{held} (it bears {max(bearing.bears, 0.0):.1f} N): "
            f"{_weakness(report, self.site.design.structures)}"
        )
        other = self._better_grips()
        if other:
            text += "; it would bear press " + " or ".join(other)
        better = self._better_supports()
        if better:
            return f"{text}; it would bear the press with support {' or '.join(better)}"
        if not self.step.up and not self.site.design.rules.support:
            return f"{text}; a support is not allowed"
        return text if other else f"{text}; no support that has room would help"

    def _bears(self, press: Press, support: Support | None) -> bool:
        return self.site.bears(press, support).stable

    def _better_grips(self) -> list[str]:
        found = (
            _entry(asdict(press))
            for press in legal_presses(self.site.item.brick)
            if press not in self.grips and self._bears(press, self.supports[0])
        )
        return list(islice(found, _HINTS))

    def _better_supports(self) -> list[str]:
        if not self.step.up and not self.site.design.rules.support:
            return []
        method = InsertionMethod.UP if self.step.up else InsertionMethod.DOWN_HELD_BELOW
        found = (
            _entry({**s.cell.entry, "orientation": s.orientation})
            for press in self.grips
            for insertion in self.site.insertions(press, method)
            if (s := insertion.support) is not None
        )
        return list(islice(dict.fromkeys(found), _HINTS))


def _entry(keys: Mapping[str, Any]) -> str:
    """Return the corresponding entry of a scenario file."""
    return "{" + ", ".join(f"{key}: {value}" for key, value in keys.items()) + "}"


def _weakness(report: StabilityReport, structures: PartialStructures) -> str:
    name = report.body or ""
    item = structures.bricks.get(name)
    what = name if item is None else f"the {item.brick.name} of {name}"
    if math.isinf(report.score):
        return f"no forces of its knobs keep {what} in balance"
    return f"{what} needs {report.score:.2f} times the friction that its knobs have"
